//! Deliverables from a run or a recording.
