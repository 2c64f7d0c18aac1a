"""Chain and corrections to the target's pose, its Jacobian and its inverse."""
