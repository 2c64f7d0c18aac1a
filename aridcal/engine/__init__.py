"""The product itself: robot, corrections, instruments, rows, model, fit, search, trust. It knows no file and no page."""
