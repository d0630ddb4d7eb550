"""Physical models: control systems with a known and an unknown part, rods, arms."""
