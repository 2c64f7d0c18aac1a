"""A URDF as a serial chain, and back: placements, motions, Doty's link model, tables of controllers."""
