# Every target sets itself up in .venv; nothing needs root. Another interpreter: make PYTHON=/path/to/python3.12 test
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
READY := .venv/.ready

# One BLAS thread: the tests run in parallel already, and the arrays are too small to gain from more.
export OMP_NUM_THREADS ?= 1
export MPLBACKEND ?= Agg
# Bytecode is kept whatever the surroundings say: tests start hundreds of processes, each of which would compile anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test suite print fuzz lint style types bench pictures docs lock matrix sbom wheel clean
.DEFAULT_GOAL := demo

DEMO := identification/arid-undeclared
demo: $(READY)
	$(BIN)/python -m aridcal.identify $(DEMO)/campaign.yaml
	@echo
	@echo "The campaign did not declare the effect that was found. Now open in a browser:"
	@echo "  $(CURDIR)/$(DEMO)/results/report.html   the answer, and the reasons for it"
	@echo "  $(CURDIR)/$(DEMO)/results/scene.html    the robot and its errors in 3D"

# Types are checked beside the tests: alone, mypy would leave all cores but one without work for a minute.
test: style
	@$(MAKE) --no-print-directory --jobs=2 types suite || \
		{ echo "make test: mypy or the tests failed, see above" >&2; exit 1; }

suite: $(READY)
	$(BIN)/pytest

# Boards, a cube of tags and sockets for a ball, at true scale: print at 100 % and measure the rulers.
SHEETS := charuco chessboard circles cube square
print: $(READY)
	for what in $(SHEETS); do for ending in svg pdf; do \
		$(BIN)/python -m aridcal.print $$what -o build/print/$$what/$$what.$$ending || exit; done; done
	for what in holder cup; do $(BIN)/python -m aridcal.print $$what -o build/print/$$what.stl || exit; done

# Ten minutes of inputs that nobody would write; what breaks a reader is kept below build/fuzz.
fuzz: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	$(BIN)/python -m fuzz

lint: style types

style: $(READY)
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(READY)
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/accuracy.py

# The pictures of the README, from the results of `make demo`.
CHROMIUM ?= chromium
SHOOT = $(CHROMIUM) --headless --no-sandbox --hide-scrollbars --use-angle=swiftshader --enable-unsafe-swiftshader \
	--virtual-time-budget=9000
pictures:
	$(SHOOT) --window-size=1280,860 --screenshot=docs/images/report.png file://$(CURDIR)/$(DEMO)/results/report.html
	$(BIN)/python docs/loop.py
	$(SHOOT) --window-size=1200,760 --screenshot=docs/images/scene.png file://$(CURDIR)/$(DEMO)/results/scene.html

# The pages of docs/ as a site in build/site, notebooks run; it opens without a network.
docs: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "open $(CURDIR)/build/site/index.html"

# The newest versions of all that developers need, for every Python and system, with hashes.
LOCK := requirements-dev.lock
lock: $(READY)
	$(BIN)/uv pip compile --quiet --upgrade --universal --generate-hashes --no-annotate \
		--custom-compile-command "make lock" --extra dev --output-file $(LOCK) pyproject.toml

# The quick tests on Python 3.11 to 3.13, with the lowest and the newest versions; CELLS="3.11-lowest" for one of them.
matrix: $(READY)
	$(BIN)/python scripts/matrix.py $(CELLS)

# What an installation consists of, as CycloneDX JSON: aridcal and what it needs, without the developers' tools.
sbom: $(READY)
	rm -rf build/sbom && mkdir -p build
	$(BIN)/uv venv --quiet --python $(BIN)/python build/sbom
	$(BIN)/uv pip install --quiet --python build/sbom/bin/python .
	$(BIN)/uvx --quiet --from cyclonedx-bom cyclonedx-py environment --pyproject pyproject.toml \
		--output-format JSON --output-file build/aridcal.cdx.json build/sbom/bin/python
	rm -rf build/sbom
	@echo "$(CURDIR)/build/aridcal.cdx.json"

# What `pip install` takes on any machine: build/wheels/aridcal-VERSION-py3-none-any.whl
wheel: $(READY)
	rm -rf build/wheels build/lib build/bdist.*
	$(BIN)/uv build --quiet --wheel --out-dir build/wheels
	@ls $(CURDIR)/build/wheels/*.whl

clean:
	rm -rf .venv build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

$(READY): pyproject.toml requirements-dev.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "aridcal needs Python 3.11 or newer: make PYTHON=/path/to/python3.11 ..." >&2; exit 2; }
	@$(PYTHON) -m venv .venv || { echo "Python's venv module is missing: on Debian, install python3-venv" >&2; exit 2; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement requirements-dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@
