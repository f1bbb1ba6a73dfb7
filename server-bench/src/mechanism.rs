//! Mechanisms against overload, and the server options that turn each on and off.

use clap::ValueEnum;

/// A mechanism against overload, named as by the server's hidden option where it has no other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mechanism {
    /// Limit of sessions per IP
    SessionsPerAddress,
    /// Token bucket per IP
    RateLimit,
    /// Turns by cost
    Turns,
    /// Deadline of requests
    Deadline,
    /// Refusal back-off
    RefusalBackoff,
    /// View selection in turns
    ViewTurns,
    /// Yields of a thread that selects views
    ViewYields,
    /// Fast effort at level 0 under backlog
    FastEffort,
}

impl Mechanism {
    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SessionsPerAddress => "sessions-per-address",
            Self::RateLimit => "rate-limit",
            Self::Turns => "turns",
            Self::Deadline => "deadline",
            Self::RefusalBackoff => "refusal-backoff",
            Self::ViewTurns => "view-turns",
            Self::ViewYields => "view-yields",
            Self::FastEffort => "fast-effort",
        }
    }

    /// The server's options that turn it on where it is off by default.
    pub const fn on(self) -> &'static [&'static str] {
        match self {
            // A fiftieth of a thread.
            Self::RateLimit => &["--rate-limit-ms", "20"],
            _ => &[],
        }
    }

    /// The server's options that turn it off where it is on by default.
    pub const fn off(self) -> &'static [&'static str] {
        match self {
            // As many as a benchmark allows in all.
            Self::SessionsPerAddress => &["--max-sessions-per-address", "4096"],
            Self::RateLimit => &[],
            // The longest that the server accepts: longer than a run.
            Self::Deadline => &["--deadline-ms", "60000"],
            Self::Turns => &["--measure-without", "turns"],
            Self::RefusalBackoff => &["--measure-without", "refusal-backoff"],
            Self::ViewTurns => &["--measure-without", "view-turns"],
            Self::ViewYields => &["--measure-without", "view-yields"],
            Self::FastEffort => &["--measure-without", "fast-effort"],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_command_line_and_no_mechanism_is_on_and_off() {
        for mechanism in Mechanism::value_variants() {
            let value = mechanism.to_possible_value().expect("a name");
            assert_eq!(mechanism.name(), value.get_name());
            assert!(mechanism.on().is_empty() != mechanism.off().is_empty(), "{mechanism:?}");
            let hidden = mechanism.off().first() == Some(&"--measure-without");
            assert!(!hidden || mechanism.off()[1] == mechanism.name());
        }
    }
}
