"""No construct that changes what a target means is corrected in silence; plain targets beside it are corrected."""

from __future__ import annotations

import pytest
from program_attacks import Attack
from programs_marked import attacks, wrong

CASES = attacks()


@pytest.mark.parametrize(("table", "attack"), CASES, ids=[f"{table}: {attack.name}" for table, attack in CASES])
def test_what_changes_the_meaning_of_a_target_is_left_and_plain_targets_are_corrected(
    table: str, attack: Attack
) -> None:
    assert not wrong(attack.files, attack.frames)
