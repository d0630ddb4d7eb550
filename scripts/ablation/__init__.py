"""Every construction on the same draws of the arm and its variations."""
