"""Readers of flight logs of autopilots, test rigs and plain tables (docs/howto/identify_from_logs.md).

``read_log`` returns a ``FlightLog`` whichever program wrote the file: named signals in SI units.
It may import the layers below ``studies``, and no study.
Read ``reading.py`` first.
"""

from qrsim.studies.flight_logs.reading import read_log
from qrsim.studies.flight_logs.signals import SIGNALS, FlightLog

__all__ = ["SIGNALS", "FlightLog", "read_log"]
