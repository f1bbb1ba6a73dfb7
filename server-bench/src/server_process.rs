//! The server under measurement: the real program in a process of its own, observed through `/proc`
//! and its metrics.

use crate::connection::{self, Connection};
use crate::mechanism::Mechanism;
use anyhow::{Context, Result, anyhow, bail};
use std::env::consts::EXE_SUFFIX;
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Clock ticks a second in `/proc`: a constant of Linux's user-space interface (proc(5),
/// `USER_HZ`).
const TICKS_PER_SECOND: f64 = 100.0;

/// Series of the server's metrics that benchmarks read.
pub mod series {
    /// Chunks generated.
    pub const GENERATED: &str = "tombolo_generation_jobs_total{outcome=\"completed\"}";
    /// Of these, encoded with the fast effort.
    pub const FAST_ENCODED: &str = "tombolo_frames_encoded_total{effort=\"fast\"}";
    /// Requests that joined a job already queued or running.
    pub const COALESCED: &str = "tombolo_frame_requests_total{outcome=\"coalesced\"}";
    /// Requests answered from the memory cache.
    pub const CACHE_HITS: &str = "tombolo_frame_requests_total{outcome=\"cache_hit\"}";
    /// Open sessions.
    pub const SESSIONS: &str = "tombolo_sessions";
    /// Open connections that are no sessions; one of them asks for the metrics.
    pub const CONNECTIONS: &str = "tombolo_connections";
    /// Generation jobs queued or running.
    pub const PENDING_JOBS: &str = "tombolo_generation_pending_jobs";
    /// CPU seconds spent on selecting views.
    pub const VIEW_SECONDS: &str = "tombolo_view_selection_busy_seconds_total";
    /// Views by what became of them: selected, superseded by a newer one, refused.
    pub const VIEWS: [&str; 3] = [
        "tombolo_views_total{outcome=\"selected\"}",
        "tombolo_views_total{outcome=\"superseded\"}",
        "tombolo_requests_rejected_total{transport=\"websocket\",reason=\"invalid_view\"}",
    ];
}

/// How to start a program under measurement.
#[derive(Clone, Debug, clap::Args)]
pub struct Launch {
    /// Server program to measure [default: tombolo-server beside this program]
    #[arg(long, value_name = "FILE")]
    pub server: Option<PathBuf>,
    /// Processors for the server, and for nginx in `cached`, as `taskset -c` takes them, such as 0
    /// or 0-3 [default: all]
    #[arg(long = "server-cpus", value_name = "LIST")]
    pub cpus: Option<String>,
    /// Turn a mechanism against overload off; `mechanisms` then measures this one alone
    #[arg(long, value_name = "NAME", value_enum)]
    pub without: Option<Mechanism>,
    /// The control group that the program joins before it starts.
    #[arg(skip)]
    pub cgroup: Option<PathBuf>,
    /// Whether its allocator asks for no huge pages, for comparisons of little memory.
    #[arg(skip)]
    pub has_small_pages: bool,
}

impl Launch {
    /// A command that runs a program on those processors.
    pub fn command(&self, program: &Path) -> Command {
        let mut words: Vec<OsString> = Vec::new();
        if let Some(cgroup) = &self.cgroup {
            // The shell joins and then becomes the program, so that its first page counts.
            words.extend(["sh", "-c", "echo $$ > \"$0\" && exec \"$@\""].map(OsString::from));
            words.push(cgroup.join("cgroup.procs").into());
        }
        if let Some(cpus) = &self.cpus {
            words.extend(["taskset".into(), "-c".into(), cpus.into()]);
        }
        words.push(program.into());
        let mut command = Command::new(&words[0]);
        command.args(&words[1..]);
        if self.has_small_pages {
            command.env("MIMALLOC_ALLOW_THP", "0");
        }
        command
    }

    fn server(&self) -> Result<PathBuf> {
        let beside = || Ok(std::env::current_exe()?.with_file_name(format!("tombolo-server{EXE_SUFFIX}")));
        self.server.clone().map_or_else(beside, Ok)
    }
}

/// A running program that is killed when dropped.
#[derive(Debug)]
pub struct ChildProcess(pub Child);

impl Drop for ChildProcess {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl ChildProcess {
    /// CPU time used so far by all threads, seconds.
    pub fn cpu_s(&self) -> Result<f64> {
        let stat = self.proc("stat")?;
        // The name in parentheses may hold anything; user and system time are the 12th and 13th
        // field behind it.
        let (_, fields) = stat.rsplit_once(')').context("/proc/PID/stat has no name")?;
        let ticks =
            |index: usize| fields.split_whitespace().nth(index).and_then(|field| field.parse::<f64>().ok());
        let (user, system) = ticks(11).zip(ticks(12)).context("/proc/PID/stat is too short")?;
        Ok((user + system) / TICKS_PER_SECOND)
    }

    /// Resident memory, bytes.
    pub fn rss_bytes(&self) -> Result<u64> {
        Ok(self.status("VmRSS:")? * 1024)
    }

    /// The most resident memory so far, bytes.
    pub fn peak_rss_bytes(&self) -> Result<u64> {
        Ok(self.status("VmHWM:")? * 1024)
    }

    /// Threads.
    pub fn threads(&self) -> Result<u64> {
        self.status("Threads:")
    }

    /// Whether it has not ended.
    pub fn is_running(&mut self) -> bool {
        matches!(self.0.try_wait(), Ok(None))
    }

    /// A number of `/proc/PID/status`, in the unit of that file.
    fn status(&self, name: &str) -> Result<u64> {
        let status = self.proc("status")?;
        let line = status.lines().find_map(|line| line.strip_prefix(name)).context(name.to_owned())?;
        line.trim().trim_end_matches(" kB").parse().context(name.to_owned())
    }

    /// Sends SIGTERM and waits for the end. Returns the time that it took; none if that is more
    /// than `limit`.
    pub async fn stop(&mut self, limit: Duration) -> Result<Option<Duration>> {
        let started = Instant::now();
        let killed = Command::new("kill").args(["-TERM", &self.0.id().to_string()]).status();
        if !killed.context("cannot run kill")?.success() {
            bail!("cannot send SIGTERM to the server");
        }
        while started.elapsed() < limit {
            if self.0.try_wait().context("cannot wait for the server")?.is_some() {
                return Ok(Some(started.elapsed()));
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        Ok(None)
    }

    fn proc(&self, file: &str) -> Result<String> {
        let path = format!("/proc/{}/{file}", self.0.id());
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {path}; measuring needs Linux"))
    }
}

/// A server on a port of its own.
#[derive(Debug)]
pub struct ServerProcess {
    /// Where it listens.
    pub address: SocketAddr,
    /// Its process.
    pub process: ChildProcess,
    panics: Arc<AtomicU32>,
}

impl ServerProcess {
    /// Starts a server with the default world and these further options.
    pub fn start(launch: &Launch, options: &[&str]) -> Result<Self> {
        let program = launch.server().context("the path of this program is unknown; give --server")?;
        // The log would have a warning where a mechanism is turned off.
        let defaults = ["--listen", "127.0.0.1:0", "--log", "error", "--max-sessions", "4096"];
        let without = launch.without.map_or(&[][..], Mechanism::off);
        let mut child = launch
            .command(&program)
            .args(last_values(&[&defaults, without, options].concat()))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {}; name it with --server", program.display()))?;
        let out = child.stdout.take().ok_or_else(|| anyhow!("the server has no standard output"))?;
        let panics = Arc::default();
        count_failures(child.stderr.take(), Arc::clone(&panics));
        let process = ChildProcess(child);
        let mut line = String::new();
        BufReader::new(out).read_line(&mut line).context("cannot read the server's first line")?;
        let Some((_, address)) = line.trim().split_once("://") else {
            bail!("expected `listening on http://ADDRESS` from the server, got `{}`", line.trim());
        };
        Ok(Self { address: address.parse().context("the server's address")?, process, panics })
    }

    /// Panics of its threads and tasks so far, as far as it has printed them.
    pub fn panics(&self) -> u32 {
        self.panics.load(Ordering::Relaxed)
    }

    /// This many clients, one after the other.
    pub async fn connect(&self, count: usize) -> Result<Vec<Connection>> {
        let mut connections = Vec::with_capacity(count);
        for _ in 0..count {
            connections.push(Connection::connect(self.address).await?);
        }
        Ok(connections)
    }

    /// The value of a counter or gauge in the server's metrics. `name` includes its labels.
    pub async fn metric(&self, name: &str) -> Result<f64> {
        Ok(self.metrics([name]).await?[0])
    }

    /// As [`ServerProcess::metric`], of several at the same time.
    pub async fn metrics<const N: usize>(&self, names: [&str; N]) -> Result<[f64; N]> {
        let text = connection::get(self.address, "/metrics").await?;
        let mut values = [0.0; N];
        for (value, name) in values.iter_mut().zip(names) {
            *value = text
                .lines()
                .find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok())
                .with_context(|| format!("the server has no metric {name}"))?;
        }
        Ok(values)
    }
}

/// Whether a line of a program is that of a panic, or of a viewer whose GPU failed: an error of it
/// that nothing handles ends the viewer with this line.
fn is_failure(line: &str) -> bool {
    line.contains("panicked at") || line.contains("the GPU failed")
}

/// Prints what a program prints and counts its failures, on a thread that ends with the program.
pub fn count_failures(from: Option<impl Read + Send + 'static>, failures: Arc<AtomicU32>) {
    let Some(from) = from else { return };
    std::thread::spawn(move || {
        for line in BufReader::new(from).lines().map_while(Result::ok) {
            failures.fetch_add(u32::from(is_failure(&line)), Ordering::Relaxed);
            eprintln!("{line}");
        }
    });
}

/// Pairs of an option and its value, of each option the last one: a program takes it only once.
fn last_values<'a>(options: &[&'a str]) -> Vec<&'a str> {
    let is_last =
        |index: &usize| !options.iter().skip(index + 2).step_by(2).any(|name| *name == options[*index]);
    (0..options.len())
        .step_by(2)
        .filter(is_last)
        .flat_map(|index| [options[index], options[index + 1]])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_and_a_failed_gpu_are_failures_and_a_bad_server_is_none() {
        assert!(is_failure("thread 'main' panicked at src/main.rs:1:1:"));
        assert!(is_failure("tombolo-view: the GPU failed: Validation Error"));
        assert!(!is_failure("tombolo-view: the server sent bad chunks: the digest differs"));
    }

    #[test]
    fn a_later_value_of_an_option_replaces_an_earlier_one() {
        let options = ["--a", "1", "--b", "--a", "--a", "2", "--c", "3"];
        assert_eq!(last_values(&options), ["--b", "--a", "--a", "2", "--c", "3"]);
    }
}
