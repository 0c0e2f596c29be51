//! What can be driven on: elevation, obstacles and drop-offs, projected into the 2D grid.
