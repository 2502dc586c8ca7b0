"""Membranes: curves of markers, their geometry, the laws of their forces, and how they slip."""
