"""Readers of flight logs: autopilots, test rigs, plain tables; see docs/identify.md."""

from qrsim.studies.flight_logs.reading import read_log
from qrsim.studies.flight_logs.signals import SIGNALS, FlightLog

__all__ = ["SIGNALS", "FlightLog", "read_log"]
