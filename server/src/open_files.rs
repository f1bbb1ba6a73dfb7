//! The limit of open files: each connection takes one, and systems often allow a process 1,024.

/// Open files that are neither sessions nor the requests beside them: as many as extra connections,
/// and files of caches, stores and logs.
const OTHERS: u64 = 512;

/// Files that a server with this many sessions may open: a session is a request first, while as
/// many others are open.
#[must_use]
pub const fn wanted(max_sessions: u64) -> u64 {
    2 * max_sessions + OTHERS
}

/// Raises the limit to what the system allows, and warns if that is less than the server may need:
/// it then cannot accept connections while all are open.
pub fn raise(max_sessions: usize) {
    let wanted = wanted(max_sessions as u64);
    if let Some(limit) = raised().filter(|limit| *limit < wanted) {
        tracing::warn!(
            limit,
            wanted,
            "few open files are allowed for --max-sessions; raise the limit (ulimit -n, LimitNOFILE)"
        );
    }
}

/// The limit after it was raised; none where there is no limit.
#[cfg(target_os = "linux")]
fn raised() -> Option<u64> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let before = getrlimit(Resource::Nofile);
    let raised = Rlimit { current: before.maximum, ..before };
    // A process may always raise its limit that far; if not, the old one stays.
    let after = setrlimit(Resource::Nofile, raised).map_or(before, |()| raised);
    after.current
}

#[cfg(not(target_os = "linux"))]
const fn raised() -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_and_a_request_take_a_file_each() {
        assert_eq!(wanted(1024), 2560);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_limit_becomes_what_the_system_allows() {
        use rustix::process::{Resource, getrlimit};
        raised();
        let limit = getrlimit(Resource::Nofile);
        assert_eq!(limit.current, limit.maximum);
    }
}
