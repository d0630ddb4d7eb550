"""The directive ``gallery``: all pictures of scripts/gallery with their captions, drawn when the site is built."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

from gallery import caption, pictures  # noqa: E402
from pisplit.pictures import keep  # noqa: E402

#: Where they are kept between builds, beside this file.
FOLDER = "_pictures"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive and what draws its pictures."""
    app.add_directive("gallery", Gallery)
    app.connect("builder-inited", draw)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def draw(app: Sphinx) -> None:
    """Draw what is older than the scripts of the gallery, or missing."""
    newest = max(path.stat().st_mtime for path in (ROOT / "scripts" / "gallery").glob("*.py"))
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    for name, picture in pictures().items():
        place = folder / f"{name}.png"
        if not place.exists() or place.stat().st_mtime < newest:
            keep(picture(), place)


class Gallery(Directive):
    """One figure a picture, with its caption and the script that draws it."""

    has_content = False

    def run(self) -> list[nodes.Node]:
        """The figures."""
        found: list[nodes.Node] = []
        for name, picture in pictures().items():
            text = caption(picture).replace("`", "")
            script = f"scripts/gallery/{picture.__module__.rsplit('.', 1)[-1]}.py"
            source = nodes.caption("", "", nodes.Text(f"{text} "), nodes.literal("", f"{script}: {name}"))
            figure = nodes.figure("", nodes.image(uri=f"{FOLDER}/{name}.png", alt=name.replace("_", " ")), source)
            found.append(figure)
        return found
