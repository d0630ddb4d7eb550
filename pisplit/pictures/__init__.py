"""What is drawn alike everywhere: figures outside pyplot, and pages that show a motion in 3-D."""

from pisplit.pictures.figures import keep, new_figure, tidy
from pisplit.pictures.page import Chart, Outline, Page

__all__ = ["Chart", "Outline", "Page", "keep", "new_figure", "tidy"]
