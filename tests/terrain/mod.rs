//! Terrain, navigation and exploration in small analytic worlds.

mod edges;
mod world;
