"""Constants of a vehicle from its flight logs, by non-linear least squares (docs/howto/identify_from_logs.md).

A fit gives each constant with its interval, and a verdict on whether the log excites it.
It may import ``flight_logs``, and the layers below ``studies``.
Read ``identification.py`` first.
"""
