"""Run folders: what a simulation recorded, on disk as Parquet, safe against a crash at any moment.

A run folder holds ``run.json`` (what was run, how far it got), ``scenario.yaml`` (the resolved scenario)
and one folder per stream (``truth``, ``measurements``, ..., ``events``) of Parquet parts
``part-00000.parquet``, ``part-00001.parquet``, .... Each part is written whole under another name and then
renamed, so whatever ends the process, all parts that bear their name are complete.
"""

from qrsim.runs.episodes import EpisodesWriter
from qrsim.runs.layout import Column, Event, RunInfo
from qrsim.runs.reader import Run, Stream, open_run
from qrsim.runs.writer import RunWriter

__all__ = ["Column", "EpisodesWriter", "Event", "Run", "RunInfo", "RunWriter", "Stream", "open_run"]
