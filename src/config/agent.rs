use super::{Check, Violation};
use crate::mission::AgentConfig;

impl Check for AgentConfig {
    fn violations(&self) -> Vec<Violation> {
        self.problems().into_iter().map(|(key, message)| Violation { key, message }).collect()
    }
}
