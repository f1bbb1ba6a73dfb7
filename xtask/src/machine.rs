//! The machine of a measurement, as far as Linux reports it, and the memory of a process.

use crate::process;
use std::fs::read_to_string;

/// Shown where the system does not say.
const UNKNOWN: &str = "unknown";

/// The machine of a record.
#[derive(Clone, Debug)]
pub struct Machine {
    /// CPU model.
    pub cpu: String,
    /// Cores that this process may use.
    pub cores: usize,
    /// Memory, MiB.
    pub memory_mib: Option<u64>,
    /// Name of the operating system.
    pub os: String,
}

impl Machine {
    /// This machine.
    pub fn here() -> Self {
        let text = |path: &str| read_to_string(path).unwrap_or_default();
        Self {
            cpu: field(&text("/proc/cpuinfo"), "model name", ':').unwrap_or_else(|| UNKNOWN.into()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory_mib: kib(&text("/proc/meminfo"), "MemTotal").map(|kib| kib / 1024),
            os: field(&text("/etc/os-release"), "PRETTY_NAME", '=')
                .map_or_else(|| UNKNOWN.into(), |name| name.trim_matches('"').into()),
        }
    }

    /// A short name for a folder: the CPU model and the number of cores.
    pub fn slug(&self) -> String {
        slug(&format!("{} {} cores", self.cpu, self.cores))
    }
}

/// Largest memory that a running process has had resident, MiB; none if it is gone or the system
/// does not say.
pub fn peak_resident_mib(pid: u32) -> Option<f64> {
    let status = read_to_string(format!("/proc/{pid}/status")).ok()?;
    kib(&status, "VmHWM").map(|kib| kib as f64 / 1024.0)
}

/// Today in UTC, `YYYY-MM-DD`.
pub fn today() -> anyhow::Result<String> {
    let mut date = process::command("date");
    date.args(["-u", "+%Y-%m-%d"]);
    process::output(date).map(|date| date.trim().into())
}

/// The state of the checkout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Commit {
    /// Abbreviated hash.
    pub hash: String,
    /// Whether no tracked or new file differs from it, records of measurements aside: a record that
    /// was just written does not change what is measured.
    pub is_clean: bool,
}

impl Commit {
    /// The state of a checkout over a run that began in this state: clean only if it was so then
    /// and now, at one commit.
    pub fn until(&self, now: Self) -> Self {
        let is_clean = now.is_clean && *self == now;
        Self { is_clean, ..now }
    }
}

/// The commit that is checked out.
pub fn commit() -> Commit {
    let git = |args: &[&str]| {
        let mut git = process::command("git");
        git.args(args);
        process::output(git)
    };
    let hash =
        git(&["rev-parse", "--short=12", "HEAD"]).map_or_else(|_| UNKNOWN.into(), |hash| hash.trim().into());
    let status = git(&["status", "--porcelain", "--", ".", ":(exclude)docs/measurements"]);
    Commit { hash, is_clean: status.is_ok_and(|changes| changes.trim().is_empty()) }
}

/// The value of the first `name<separator>value` line.
fn field(text: &str, name: &str, separator: char) -> Option<String> {
    text.lines().find_map(|line| {
        let (key, value) = line.split_once(separator)?;
        (key.trim() == name && !value.trim().is_empty()).then(|| value.trim().into())
    })
}

/// A `Name:  123 kB` line of /proc.
fn kib(text: &str, name: &str) -> Option<u64> {
    field(text, name, ':')?.strip_suffix("kB")?.trim().parse().ok()
}

/// Lower-case words of a name joined by single dashes, at most 60 characters.
fn slug(name: &str) -> String {
    // "(R)", "(TM)" and the clock say nothing that distinguishes machines.
    let name = name.replace("(R)", "").replace("(TM)", "");
    let words = name.split(|c: char| !c.is_ascii_alphanumeric() && c != '.').filter(|word| !word.is_empty());
    let joined = words.collect::<Vec<_>>().join("-").to_lowercase();
    joined.chars().take(60).collect::<String>().trim_matches(['-', '.']).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkout_is_clean_only_if_it_was_so_from_the_start() {
        let state = |hash: &str, is_clean| Commit { hash: hash.into(), is_clean };
        for (begun, now, is_clean) in [
            (state("a", true), state("a", true), true),
            (state("a", false), state("a", true), false),
            (state("a", false), state("b", true), false),
            (state("a", true), state("b", true), false),
            (state("a", true), state("a", false), false),
        ] {
            let over = begun.until(now.clone());
            assert_eq!(over, Commit { is_clean, ..now }, "from {begun:?}");
        }
    }

    #[test]
    fn peak_memory_is_read_from_a_status_file_and_nothing_else() {
        let status = "Name:\ttombolo-server\nVmPeak:\t  900 kB\nVmHWM:\t  123456 kB\nVmRSS:\t 99 kB\n";
        assert_eq!(kib(status, "VmHWM"), Some(123_456));
        for broken in ["", "VmHWM:", "VmHWM: many kB", "VmHWM: 12 pages", "xVmHWM: 12 kB", "VmHWM 12 kB"] {
            assert_eq!(kib(broken, "VmHWM"), None, "{broken:?}");
        }
    }

    #[test]
    fn this_process_has_a_peak_and_a_process_that_cannot_exist_has_none() {
        assert!(peak_resident_mib(std::process::id()).is_none_or(|mib| mib > 0.1));
        assert_eq!(peak_resident_mib(u32::MAX), None);
    }

    #[test]
    fn slugs_are_plain_folder_names() {
        for (name, expected) in [
            ("Intel(R) Xeon(R) CPU @ 2.20GHz 2 cores", "intel-xeon-cpu-2.20ghz-2-cores"),
            ("AMD EPYC 7B13", "amd-epyc-7b13"),
            ("  ../..  ", ""),
            ("é", ""),
        ] {
            assert_eq!(slug(name), expected);
        }
        assert!(slug(&"word ".repeat(50)).len() <= 60);
    }

    #[test]
    fn today_is_a_date() {
        let today = today().unwrap();
        assert_eq!(today.len(), 10, "{today}");
        assert_eq!(today.matches('-').count(), 2);
    }
}
