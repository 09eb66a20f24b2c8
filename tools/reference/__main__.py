"""Write the generated pages of docs/reference/; with ``--check`` say which differ instead, and end with exit code 1."""

from __future__ import annotations

import sys

from tools.reference import FOLDER, MODULES, made

different = []
for module in MODULES:
    for name, text in made(module).items():
        path = FOLDER / name
        if path.exists() and path.read_text("utf-8") == text:
            continue
        different.append(name)
        if "--check" not in sys.argv:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
            print(f"wrote {path}")
if different and "--check" in sys.argv:
    sys.exit(f"docs/reference: {', '.join(different)} differ from the code; run 'make docs-pages'")
