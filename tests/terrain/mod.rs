//! Terrain, navigation and exploration in small analytic worlds.

mod closed_loop;
mod edges;
mod explore;
mod world;
