//! Localisation and the map of planar landmarks.
