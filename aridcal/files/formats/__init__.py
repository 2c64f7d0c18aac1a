"""How tables of other programs are written: found out by looking at them, once, by `aridcal init`."""
