"""The membrane: marker shapes, geometry and forces."""
