//! Map, scan and recording files read here and handed down as values.
