"""What is not measured: disturbances that make a model of the plant offset-free, and states among noise."""
