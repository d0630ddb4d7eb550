"""A scene for other uses: pictures, C code, compiled functions."""
