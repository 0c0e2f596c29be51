//! The wire: lines to typed messages and commands to lines, in both dialects.
