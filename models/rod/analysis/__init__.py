"""What a scene tells about itself: energy, natural modes, fields along the arclength, cost of its equations."""
