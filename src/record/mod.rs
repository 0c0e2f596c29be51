//! Recordings: the session codec, its writer and reader.
