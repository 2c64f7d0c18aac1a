# Every target sets itself up in .venv; nothing needs root. Another interpreter: make PYTHON=/path/to/python3.12 test
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
READY := .venv/.ready

# One BLAS thread: the tests run in parallel already, and the arrays are too small to gain from more.
export OMP_NUM_THREADS ?= 1
export MPLBACKEND ?= Agg

.PHONY: demo test fuzz lint bench pictures docs clean
.DEFAULT_GOAL := demo

DEMO := identification/arid-undeclared
demo: $(READY)
	$(BIN)/python -m aridcal.identify $(DEMO)/campaign.yaml
	@echo
	@echo "The campaign did not declare the effect that was found. Now open in a browser:"
	@echo "  $(CURDIR)/$(DEMO)/results/report.html   the answer, and the reasons for it"
	@echo "  $(CURDIR)/$(DEMO)/results/scene.html    the robot and its errors in 3D"

test: lint
	$(BIN)/pytest

# Ten minutes of inputs that nobody would write; what breaks a reader is kept below build/fuzz.
fuzz: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	$(BIN)/python -m fuzz

lint: $(READY)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/accuracy.py

# The pictures of the README, from the results of `make demo`.
CHROMIUM ?= chromium
SHOOT = $(CHROMIUM) --headless --no-sandbox --hide-scrollbars --use-angle=swiftshader --enable-unsafe-swiftshader \
	--virtual-time-budget=9000
pictures:
	$(SHOOT) --window-size=1200,620 --screenshot=docs/images/report.png file://$(CURDIR)/$(DEMO)/results/report.html
	$(SHOOT) --window-size=1200,760 --screenshot=docs/images/scene.png file://$(CURDIR)/$(DEMO)/results/scene.html

# The pages of docs/ as a site in build/site, notebooks run; it opens without a network.
docs: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "open $(CURDIR)/build/site/index.html"

clean:
	rm -rf .venv build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "aridcal needs Python 3.11 or newer: make PYTHON=/path/to/python3.11 ..." >&2; exit 2; }
	@$(PYTHON) -m venv .venv || { echo "Python's venv module is missing: on Debian, install python3-venv" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@
