"""The verdict on an operation before a field day, with the statistics behind it (docs/howto/brief_a_mission.md).

A brief flies studies of ``sweep`` and reads their stores.
It may import the other studies, and the layers below ``studies``.
Read ``operation.py`` first.
"""
