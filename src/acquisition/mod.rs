//! Taking 3D scans: stop, step the tilt, wait, file the line.
