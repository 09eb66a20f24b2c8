"""Laws of a vehicle from its flight logs, by co-evolution of expressions (docs/howto/identify_from_logs.md).

A log is split: evolution sees its first part, and the laws are scored on the rest.
It may import ``flight_logs``, and the layers below ``studies``.
Read ``discovery.py`` first.
"""
