"""Studies that measure what the documentation states; ``python -m evidence`` runs them.

Each module here with a ``run(full: bool) -> dict`` of plain numbers (nested dicts allowed) is a study. It has a
DOC string and, where it draws numbers, a SEED. The full form is written to docs/evidence/NAME.json; the tests
run the small form, so that the code behind a published number is the code under test. References, rigs and wrong input
that tests use as well are in tests/, in the folder of the tests that use them.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
