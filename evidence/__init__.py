"""Studies that measure what the documentation states; ``python -m evidence`` runs them.

Each module here with a ``run(full: bool) -> dict`` of plain numbers (nested dicts allowed) is a study. It has a
DOC string and, where it draws numbers, a SEED. The full form is written to docs/evidence/NAME.json; the tests
run the small form, so that the code behind a published number is the code under test.
"""
