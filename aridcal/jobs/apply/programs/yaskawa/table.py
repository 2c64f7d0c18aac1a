"""What every instruction of a job does, after the INFORM manuals of NX100 to YRC1000.

Instructions are compared as :func:`aridcal.jobs.apply.programs.yaskawa.listing.plain` writes them: capitals, no remarks,
single blanks. What matches no row is unknown: all that it may have changed is unknown behind it. That an instruction names a
position is looked at apart from what it does: whatever it is, it then uses that position otherwise than to go there.
"""

from __future__ import annotations

from typing import NamedTuple

INDEX = r"(?:\d{1,9}|\[[^\[\]]*\])"
"""Of a variable: a number, or what is worked out."""

VALUE = rf"(?:\d+(?:\.\d*)?|L?[BIDR]{INDEX})%?"

HARMLESS = (
    "NOP",
    # signals, waits and messages
    r"(?:DOUT|AOUT|PULSE|DIN|WAIT|TIMER|TSYNC|CWAIT|SETUALM|MSG|CLS|PRINT|DIALOG|INPUT|SKILLSND)\b.*",
    r"PAUSE(?: IF(?:EXPRESS)?\b.*)?",
    r"ADV(?:INIT|STOP)",
    r"PWAIT\b.*",
    # variables and registers: positions among them are looked at apart
    r"(?:CLEAR|INC|DEC|SET|ADD|SUB|MUL|DIV|AND|OR|NOT|XOR|SQRT|SIN|COS|ATAN|MULMAT|INVMAT)\b.*",
    r"(?:SETE|GETE|GETS|GETPOS|CNVRT|MSHIFT|GETARG|SETREG|GETREG|SETTM)\b.*",
    r"(?:VAL|ASC|CHR\$|MID\$|LEN|CAT\$)\b.*",
    r"GETFILE\b.*",
    r"SETFILE (?:WEV|ASF|AEF)#.*",
    # speeds, points of reference
    r"(?:SPEED|REFP)\b.*",
    # processes along the way
    r"ARC(?:ON|OF|SET|CTS|CTE|CUR|VOL)\b.*",
    r"WV(?:ON|OF|ADJ)\b.*",
    r"(?:VWELD|AWELD|WIRINC|WIRSTK|GASON|GASOF)\b.*",
    r"(?:HAND|HSEN|TOOLON|TOOLOF)\b.*",
    r"(?:SPOT|SVSPOT|GUNCL|STROKE|STRWAIT)\b.*",
)
"""Instructions that change nothing of frames, tools, shifts, and of the way through the job."""

CHANGES: tuple[tuple[str, str], ...] = (
    ("shift on", r"SFTON(?:3D)?\b.*"),
    ("shift off", r"SFTOF(?:3D)?\b.*"),
    ("frame", r"MFRAME (?:RB1 )?UF#\((?P<index>[^()]*)\).*"),
    ("tool", r"SETTOOL (?:RB1 )?TL#\((?P<index>[^()]*)\).*"),
    ("task", r"PSTART\b.*"),
)
"""Instructions that change one thing, by what they change."""

PLACE = rf"(?:(?:BC|EC|C)\d{{1,9}}|L?(?:BP|EX|PX|P){INDEX})"
"""A position that a move names, or a variable that holds one."""

MOVE = rf"(?P<how>S?MOV[JLCS])(?P<places>(?: {PLACE})*)(?P<options>(?: .*)?)"

STATION = rf"\+MOV[JLCS](?: (?:EC\d{{1,9}}|L?EX{INDEX}))+"
"""The move of a station beside it: where the arm goes does not depend on it."""


class Option(NamedTuple):
    """What may stand behind the places of a move.

    Attributes:
        pattern: How it stands there.
        why: Why the place is left; empty where it changes nothing of where the arm goes.
        trap: Whether the program may go on elsewhere behind it.
    """

    pattern: str
    why: str = ""
    trap: bool = False


OPTIONS = (
    Option(rf"(?:VJ|VR|VE|VMAX|V|PL|CR|PD|ACC|DEC|SPDL)= ?{VALUE}(?= |$)"),
    Option(r"NWAIT(?= |$)"),
    Option(rf"ENWAIT(?: (?:T|DIS)= ?{VALUE})?(?= |$)"),
    Option(r"FPT(?= |$)"),
    Option(r"UNTIL [^ ]+(?= |$)"),
    Option(STATION + "(?= |$)"),
    Option(r"TRAP \*(?P<label>[^ ]+)", trap=True),
    Option(rf"MTE?= ?{VALUE}", "an axis is turned by whole turns (MT=)"),
    Option(r"TL#\([^()]*\)", "another tool goes there (TL#)"),
    Option(r"UF#\([^()]*\)", "it is meant in another user frame (UF#)"),
    Option(r"(?:AS|HPS|NS|S)RCH\b.*", "it searches on its way there"),
    Option(r"\+SFTON3D\b.*", "it is shifted (+SFTON3D)"),
    Option(r"\+MOV[JLCS]\b.*", "another robot or its base moves with it"),
)

HEADERS = (r"DATE\b.*", r"COMM\b.*", r"LVARS\b.*", r"FOLDERNAME\b.*")
"""Lines of a job's head that have nothing to do with places."""
