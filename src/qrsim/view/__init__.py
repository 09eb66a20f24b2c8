"""The live 3-D page: frames of a state or recording, the layers that draw them, and the web server.

It needs viser, which 'qrsim[view]' installs; all but ``flight.py`` is imported only when a page is opened. Everything
is drawn in NED.
It may import ``runs`` and the layers below it.
Read ``frame.py`` first.
"""
