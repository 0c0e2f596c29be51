//! Scenario, robot and agent configuration: read, checked and handed down as values.
