"""The fluid on a staggered grid: layout, walls and difference operators."""
