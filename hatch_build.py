"""Packs the libraries that the pages of trueplant app draw with, and their licences, into the wheel and the sdist.

They come from node_modules, which `npm ci` fills by the hashes of package-lock.json; they are never committed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKED = {"wheel": "trueplant/app/vendor", "sdist": "src/trueplant/app/vendor"}


class VendorHook(BuildHookInterface):  # type: ignore[type-arg]
    """The build hook."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """An editable install finds node_modules by itself; a wheel that is made from an sdist has them in it."""
        root = Path(self.root)
        if version == "editable" or (root / PACKED["sdist"]).is_dir():
            return
        names = json.loads((root / "src/trueplant/app/vendor.json").read_text(encoding="utf-8"))
        found = {name: root / "node_modules" / place for name, place in names.items()}
        missing = [str(path.relative_to(root)) for path in found.values() if not path.is_file()]
        if missing:
            self.app.display_warning(
                f"{', '.join(missing)}: not there, so the trueplant app of this build cannot draw: run npm ci first"
            )
            return
        for name, path in found.items():
            build_data["force_include"][str(path)] = f"{PACKED[self.target_name]}/{name}"
