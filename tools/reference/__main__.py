"""Write the generated pages of docs/reference/."""

from __future__ import annotations

import time

from tools.reference import FOLDER, MODULES, made

for module in MODULES:
    begun = time.perf_counter()
    for name, text in made(module).items():
        path = FOLDER / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    print(f"{module}: {time.perf_counter() - begun:.1f} s")
