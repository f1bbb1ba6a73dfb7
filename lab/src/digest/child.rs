//! Child processes and scratch folders with clean-up on exit and on interrupts.
//!
//! Each child leads a process group of its own, because browsers are many processes and scripts
//! that wrap them are one more. An interrupt from the terminal therefore no longer reaches them by
//! itself: [`clean_up_when_interrupted`] passes it on. Only SIGKILL leaves them behind.

use anyhow::{Context, Result};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Interval of polling a child.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Time from SIGTERM to SIGKILL.
const TERMINATE_TIMEOUT: Duration = Duration::from_secs(2);

/// Exit code after an interrupt, as shells report SIGINT.
const INTERRUPTED: i32 = 130;

/// Resources to clean up.
struct Resources {
    groups: Vec<u32>,
    folders: Vec<PathBuf>,
}

static RESOURCES: Mutex<Resources> = Mutex::new(Resources { groups: Vec::new(), folders: Vec::new() });

fn resources() -> MutexGuard<'static, Resources> {
    RESOURCES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// From now on SIGINT and SIGTERM end all children and remove all folders of this module before
/// this program exits with 130.
///
/// # Errors
/// Another handler is installed.
pub fn clean_up_when_interrupted() -> Result<()> {
    let clean_up = || {
        // The lock is held to the end: a guard dropped meanwhile waits, so no other exit comes
        // first.
        let resources = resources();
        resources.groups.iter().for_each(|group| end(*group, || ()));
        resources.folders.iter().for_each(|folder| remove(folder));
        std::process::exit(INTERRUPTED);
    };
    ctrlc::set_handler(clean_up).context("interrupts cannot be caught")
}

/// A child that is ended with its whole process group when this is dropped.
#[derive(Debug)]
pub struct ChildGuard(Child);

impl ChildGuard {
    /// Starts it as the head of a group.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(command: &mut Command) -> std::io::Result<Self> {
        // Locked before the start, so that no interrupt comes between it and the note.
        let mut resources = resources();
        let child = command.process_group(0).spawn()?;
        resources.groups.push(child.id());
        Ok(Self(child))
    }

    pub const fn child(&mut self) -> &mut Child {
        &mut self.0
    }

    /// Waits until the child has ended by itself; none if it runs on at the deadline.
    ///
    /// # Errors
    /// Its status cannot be read.
    pub fn ends_before(&mut self, deadline: Instant) -> std::io::Result<Option<ExitStatus>> {
        loop {
            let status = self.0.try_wait()?;
            if status.is_some() || Instant::now() >= deadline {
                return Ok(status);
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }
}

impl Drop for ChildGuard {
    fn drop(&mut self) {
        let mut resources = resources();
        let group = self.0.id();
        // A head that has ended counts as a member of its group until it is collected.
        end(group, || {
            let _ = self.0.try_wait();
        });
        // Both fail only where the child has ended and been collected; they matter where there is
        // no `kill` program.
        let _ = self.0.kill();
        let _ = self.0.wait();
        resources.groups.retain(|other| *other != group);
    }
}

/// Ends a group: SIGTERM, and after the timeout SIGKILL. `poll` runs at every interval.
fn end(group: u32, mut poll: impl FnMut()) {
    let deadline = Instant::now() + TERMINATE_TIMEOUT;
    let mut lives = signal(group, "-TERM");
    while lives && Instant::now() < deadline {
        std::thread::sleep(POLL_INTERVAL);
        poll();
        lives = signal(group, "-0");
    }
    if lives {
        signal(group, "-KILL");
    }
}

/// Whether a process received the signal. The standard library can only kill a single child; a
/// group needs the `kill` program.
fn signal(group: u32, signal: &str) -> bool {
    let mut kill = Command::new("kill");
    kill.args([signal, "--", &format!("-{group}")]);
    kill.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success())
}

/// A folder under the system's temporary one, removed with this value.
#[derive(Debug)]
pub struct Scratch(PathBuf);

impl Scratch {
    /// Creates it; the name gets this process's number.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn new(name: &str) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("{name}-{}", std::process::id()));
        let mut resources = resources();
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("`{}` cannot be created", folder.display()))?;
        resources.folders.push(folder.clone());
        Ok(Self(folder))
    }

    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let mut resources = resources();
        remove(&self.0);
        resources.folders.retain(|other| *other != self.0);
    }
}

fn remove(folder: &Path) {
    // An ending process may still be writing into it.
    for _ in 0..50 {
        if std::fs::remove_dir_all(folder).is_ok() || !folder.exists() {
            return;
        }
        std::thread::sleep(POLL_INTERVAL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn a_child_is_ended_with_its_own_children() {
        let scratch = Scratch::new("tombolo-lab-child").unwrap();
        let (note, folder) = (scratch.path().join("pid"), scratch.path().to_owned());
        let mut command = Command::new("sh");
        command.args(["-c", "sleep 600 & echo $! > \"$0.new\"; mv \"$0.new\" \"$0\"; wait"]).arg(&note);
        let guarded = ChildGuard::start(&mut command).unwrap();
        let deadline = Instant::now() + Duration::from_secs(10);
        while !note.exists() && Instant::now() < deadline {
            std::thread::sleep(POLL_INTERVAL);
        }
        let grandchild = std::fs::read_to_string(&note).unwrap();
        drop(guarded);
        // Its number stays taken until someone collects it; a number that is gone or belongs to the
        // ended is both an end.
        let state = std::fs::read_to_string(format!("/proc/{}/stat", grandchild.trim())).unwrap_or_default();
        let state = state.rsplit(')').next().unwrap_or_default().trim_start();
        assert!(state.is_empty() || state.starts_with(['Z', 'X']), "{state}");
        drop(scratch);
        assert!(!folder.exists());
    }

    #[test]
    fn running_and_ended_children_are_distinguished() {
        let mut runs = ChildGuard::start(Command::new("sleep").arg("600")).unwrap();
        assert_eq!(runs.ends_before(Instant::now()).unwrap(), None);
        let mut ends = ChildGuard::start(Command::new("false").stdin(Stdio::null())).unwrap();
        let status = ends.ends_before(Instant::now() + Duration::from_secs(10)).unwrap().unwrap();
        assert!(!status.success());
    }
}
