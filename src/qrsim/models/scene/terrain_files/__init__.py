"""Digital elevation models with a coordinate reference system: GeoTIFF, SRTM, ASCII grids with .prj, VRT, and tiles.

Files are read once, when a world is built. GDAL and PROJ run in a process of their own (``gdal.py``), because the files
come from elsewhere.
Read ``survey.py`` first.
"""
