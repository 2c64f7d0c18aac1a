"""Robot calibration that explains itself.

Example:
    import aridcal

    poses = aridcal.plan("campaign.yaml", 30)  # which to measure next
    for pose in aridcal.guide("campaign.yaml", tolerance="0.2mm"):  # or one by one, until it is enough
        pose.record(my_robot(pose.joints))
    campaign = aridcal.propose("ur5.urdf", table)  # a path or a DataFrame; prints what was guessed
    cal = aridcal.calibrate(campaign)  # or the path of a campaign.yaml
    cal.errors, cal.effects, cal.parameters  # DataFrames
    cal.plot.errors()  # a figure of matplotlib; also joints(), residuals(), workspace()
    poses = cal.predict(queries)
    joints = cal.compensate(poses, seed=queries)
    cal.save("results")
    aridcal.compare("results/march", "results/april").causes  # what changed
    aridcal.fleet("robots/*/campaign.yaml", "fleet").robots  # many robots, the worst first
    aridcal.history("fleet").alarms  # which robots drift
    table = aridcal.merge("joints.csv", "tracker.csv", "ur5.urdf", "tool0")  # two logs, each with its clock
"""

from __future__ import annotations

from aridcal.system import interrupt

interrupt.watch()  # before all other imports: they take a second, in which Ctrl-C would print a traceback

from typing import TYPE_CHECKING  # noqa: E402

__version__ = "0.1.0"
__all__ = [
    "AridcalError",
    "Calibration",
    "Campaign",
    "Guided",
    "PlannedPoses",
    "__version__",
    "calibrate",
    "compare",
    "fleet",
    "guide",
    "history",
    "load",
    "merge",
    "plan",
    "propose",
    "study",
]

if TYPE_CHECKING:
    from aridcal.api import (
        Guided,
        PlannedPoses,
        calibrate,
        compare,
        fleet,
        guide,
        history,
        load,
        merge,
        plan,
        propose,
        study,
    )
    from aridcal.calibration import Calibration
    from aridcal.files.campaign import Campaign
    from aridcal.system.errors import AridcalError
else:
    import sys
    from types import ModuleType

    class _Face(ModuleType):
        """The package: its verbs stay functions when a command's module of the same name is imported, which would hide them."""

        def __setattr__(self, name, value):
            if not (name in __all__ and isinstance(value, ModuleType)):
                super().__setattr__(name, value)

    sys.modules[__name__].__class__ = _Face

    def __getattr__(name):
        """Load the face when it is asked for (PEP 562): Pinocchio and pandas would make every command slow to start."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from aridcal import api

        return getattr(api, name)

    def __dir__():
        return sorted({*globals(), *__all__})
