"""Draw the pictures of the gallery (scripts/gallery), those that are there already left out unless --force is given."""

from __future__ import annotations

import time

from tqdm import tqdm

from common.report import Report, parser, run
from gallery import pictures
from pisplit.pictures import keep


def main() -> None:
    """Draw all pictures, or those named; CPU seconds of each as a table."""
    made = parser((__doc__ or "").splitlines()[0], out="out/gallery")
    made.add_argument("--only", nargs="+", metavar="NAME", help="names of pictures")
    made.add_argument("--force", action="store_true", help="draw those anew that are there")
    given = made.parse_args()
    every = pictures()
    unknown = [name for name in given.only or () if name not in every]
    if unknown:
        raise ValueError(f"--only {' '.join(unknown)}; expected some of {', '.join(every)}")
    names = given.only or list(every)[:: 6 if given.quick else 1]
    report = Report.of("pictures of the gallery", given)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in tqdm(names, desc="gallery", unit="picture"):
        place = given.out / f"{name}.png"
        if given.force or not place.exists():
            begin = time.process_time()
            keep(every[name](), place)
            report.figure(name, time.process_time() - begin, "s of CPU")
    print(f"{report}\n{len(names)} pictures in {given.out}")
    report.write(given.json)


if __name__ == "__main__":
    run(main)
