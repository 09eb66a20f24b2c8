"""Many conditions flown on all cores or a cluster, and their analysis (docs/howto/own_study.md).

The studies that come with qrsim are the YAML files of this folder.
It may import ``flight_logs``, and the layers below ``studies``.
Read ``study.py`` first.
"""
