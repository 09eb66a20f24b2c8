"""Validation of the models against recordings and closed forms (docs/explanation/paper.md).

A check compares with a closed form or a published number; a finding rates a model against a recording.
It may import ``flight_logs``, and the layers below ``studies``.
Read ``parts.py`` first.
"""
