"""No construct that changes what a target means is corrected in silence; plain targets beside it are corrected."""

from __future__ import annotations

from collections import defaultdict

import pytest
from program_attacks import Attack
from programs_marked import attacks, wrong

TABLES: dict[str, list[Attack]] = defaultdict(list)
for _table, _attack in attacks():
    TABLES[_table].append(_attack)


@pytest.mark.parametrize("table", TABLES)
def test_what_changes_the_meaning_of_a_target_is_left_and_plain_targets_are_corrected(table: str) -> None:
    faults = {attack.name: wrong(attack.files, attack.frames) for attack in TABLES[table]}
    assert {name: fault for name, fault in faults.items() if fault} == {}
