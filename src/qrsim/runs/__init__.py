"""Run folders: the record of a simulation on disk as Parquet, and figures, comparisons and exports of it.

A run folder holds ``run.json`` (settings, progress), ``scenario.yaml`` (resolved) and one folder per stream (``truth``,
``measurements``, ..., ``events``) of Parquet parts ``part-00000.parquet``, .... Each part is written under another
name and then renamed, so every part under its final name is complete, however the process ended.
It may import ``scenarios`` and the layers below it.
Read ``reader.py`` first.
"""

from qrsim.runs.episodes import EpisodesWriter
from qrsim.runs.layout import Column, Event, RunInfo
from qrsim.runs.reader import Run, open_run
from qrsim.runs.stream_arrays import Stream
from qrsim.runs.writer import RunWriter

__all__ = ["Column", "EpisodesWriter", "Event", "Run", "RunInfo", "RunWriter", "Stream", "open_run"]
