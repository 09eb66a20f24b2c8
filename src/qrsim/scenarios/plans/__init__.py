"""Plans of other software as one record: .plan, QGC WPL, KML, KMZ, GPX and GeoJSON.

``commands.py`` is the table of mission commands, for files and for the MAVLink link; ``route.py`` turns items into
waypoints, ``legs.py`` turns waypoints into legs of a mission. Readers know nothing of a scenario.
"""
