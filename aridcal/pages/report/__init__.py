"""Pages and pictures. Nothing is computed here that a result does not hold."""
