"""Turn a series of the public UR10 data set into a table in SI: see README.md.

Example:
    python convert.py Series_B/measurements_joint_configurations.csv series_b.csv
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

JOINTS = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]


def convert(source: pd.DataFrame) -> pd.DataFrame:
    """Rows of the source, mm and degrees in Euler angles, as rows in m, rad and quaternions."""
    table = source[[f"{joint}_joint" for joint in JOINTS]].copy()
    for axis in "xyz":
        table[axis] = 1e-3 * source[f"measurement_{axis}"]
    angles = source[[f"measurement_r{axis}" for axis in "xyz"]].to_numpy()
    quaternions = Rotation.from_euler("XYZ", angles, degrees=True).as_quat(canonical=True)
    table[["qx", "qy", "qz", "qw"]] = quaternions
    for axis in "xyz":
        table[f"std_{axis}"] = 1e-3 * source[f"measurement_std_{axis}"]
    for axis in "xyz":
        table[f"std_r{axis}"] = np.radians(source[f"measurement_std_r{axis}"])
    table["temperature"] = source["measurement_temperature"]
    table["sequence"] = range(len(table))
    return table


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    convert(pd.read_csv(sys.argv[1], sep=";", decimal=",")).to_csv(sys.argv[2], index=False, float_format="%.10g")
