"""``python -m pisplit``: the same as the command ``pisplit``, where that is not on the path."""

import sys

if __name__ == "__main__":
    from pisplit.front.commands import main

    sys.exit(main())
