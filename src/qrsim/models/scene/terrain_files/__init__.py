"""Digital elevation models with a coordinate reference system: GeoTIFF, SRTM, ASCII grids with .prj, VRT, and tiles.

Files are read once, when a world is built. GDAL and PROJ run in a separate process (``gdal.py``), because the files may
be damaged or hostile.
Read ``survey.py`` first.
"""
