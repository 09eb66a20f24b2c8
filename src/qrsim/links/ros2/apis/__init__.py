"""Topics and services of other software, mavros and PX4's uXRCE-DDS bridge, for vehicles with a flight stack."""
