"""How the long commands end: with their figures as JSON, and 1 where a goal is missed."""

import json
import sys
from pathlib import Path
from typing import Any, NoReturn


def finish(figures: dict[str, Any], met: bool, path: Path | None, shown: str | None = None) -> NoReturn:
    """Print the figures (or ``shown`` in their place), write them to ``path``, and end the process."""
    text = json.dumps(figures, indent=1)
    print(text if shown is None else shown)
    if path:
        path.write_text(text + "\n")
    sys.exit(0 if met else 1)
