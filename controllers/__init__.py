"""Linear MPC on a lifted model and closed loops on a plant."""
