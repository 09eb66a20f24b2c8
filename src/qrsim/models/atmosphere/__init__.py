"""The air: mean wind, gusts, turbulence."""
