"""Random and extreme scenes and data: where the rod and the identification stop."""
