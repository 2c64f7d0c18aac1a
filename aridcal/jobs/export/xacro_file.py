"""Calibrated joint origins as a macro for those who keep their robot's description in xacro."""

from __future__ import annotations

import re
from collections.abc import Iterable

from aridcal.engine.robot.splice import origin_texts
from aridcal.jobs.export.calibrated_tree import CalibratedTree, as_comment, as_text
from aridcal.system.errors import OutputError, shortened

NAMES = re.compile(r"[\w. /:-]+")
"""Of joints, that can stand in an expression of xacro: no quotes, no braces, no dollars."""


def xacro(tree: CalibratedTree, about: Iterable[str]) -> str:
    """Write the macro ``calibrated_origin``: for the name of a joint, its ``<origin>``.

    Args:
        tree: The robot.
        about: What the file says of itself, a line each.

    Raises:
        OutputError: a joint has a name that xacro cannot hold.
    """
    for name in tree.tree.joints:
        if not NAMES.fullmatch(name):
            raise OutputError(f"joint {shortened(name)!r}: a name that expressions of xacro cannot hold: rename it")
    vectors = origin_texts(tree.urdf, tree.tree.origins)
    tables = {
        key: ",\n    ".join(f"({name!r}, {as_text(of[k])!r})" for name, of in vectors.items())
        for k, key in enumerate(("xyz", "rpy"))
    }
    properties = [
        f'  <xacro:property name="calibrated_{key}" value="${{dict([\n    {table}])}}"/>'
        for key, table in tables.items()
    ]
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            f"<!--{as_comment(about)}-->",
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">',
            *properties,
            '  <xacro:macro name="calibrated_origin" params="joint">',
            '    <origin xyz="${calibrated_xyz[joint]}" rpy="${calibrated_rpy[joint]}"/>',
            "  </xacro:macro>",
            "</robot>",
            "",
        ]
    )
