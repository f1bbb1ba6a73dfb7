//! Child processes and scratch folders that must neither hang nor stay, whatever ends this program.
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

/// Pause between looks at a child.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How long a group has to end by itself after SIGTERM.
const PATIENCE: Duration = Duration::from_secs(2);

/// Exit code after an interrupt, as shells say it of SIGINT.
const INTERRUPTED: i32 = 130;

/// What is still to be ended and removed.
struct Left {
    groups: Vec<u32>,
    folders: Vec<PathBuf>,
}

static LEFT: Mutex<Left> = Mutex::new(Left { groups: Vec::new(), folders: Vec::new() });

fn left() -> MutexGuard<'static, Left> {
    LEFT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// From now on SIGINT and SIGTERM end all children and remove all folders of this module before
/// this program exits with 130.
///
/// # Errors
/// Another handler is installed.
pub fn clean_up_when_interrupted() -> Result<()> {
    let clean_up = || {
        // Held to the end: a guard that is dropped meanwhile waits here, so that no other exit
        // comes first.
        let left = left();
        left.groups.iter().for_each(|group| end(*group, || ()));
        left.folders.iter().for_each(|folder| remove(folder));
        std::process::exit(INTERRUPTED);
    };
    ctrlc::set_handler(clean_up).context("interrupts cannot be caught")
}

/// A child that is ended with its whole process group when this is dropped.
#[derive(Debug)]
pub struct Guarded(Child);

impl Guarded {
    /// Starts it as the head of a group.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(command: &mut Command) -> std::io::Result<Self> {
        // Locked before the start, so that no interrupt comes between it and the note.
        let mut left = left();
        let child = command.process_group(0).spawn()?;
        left.groups.push(child.id());
        Ok(Self(child))
    }

    /// The child, to talk to.
    pub const fn child(&mut self) -> &mut Child {
        &mut self.0
    }

    /// Waits until the child has ended by itself; none if it runs on at the deadline.
    ///
    /// # Errors
    /// It cannot be asked.
    pub fn ends_before(&mut self, deadline: Instant) -> std::io::Result<Option<ExitStatus>> {
        loop {
            let status = self.0.try_wait()?;
            if status.is_some() || Instant::now() >= deadline {
                return Ok(status);
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        let mut left = left();
        let group = self.0.id();
        // A head that has ended counts as a member of its group until it is collected.
        end(group, || {
            let _ = self.0.try_wait();
        });
        // Both fail only where the child has ended and been collected; they matter where there is
        // no `kill` program.
        let _ = self.0.kill();
        let _ = self.0.wait();
        left.groups.retain(|other| *other != group);
    }
}

/// Ends a group: SIGTERM, and after the patience SIGKILL. `look` runs between looks at it.
fn end(group: u32, mut look: impl FnMut()) {
    let deadline = Instant::now() + PATIENCE;
    let mut lives = signal(group, "-TERM");
    while lives && Instant::now() < deadline {
        std::thread::sleep(LOOK_EVERY);
        look();
        lives = signal(group, "-0");
    }
    if lives {
        signal(group, "-KILL");
    }
}

/// Whether a signal reached anyone. The standard library can only kill a single child; a group
/// takes the `kill` of the system.
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
        let mut left = left();
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("`{}` cannot be created", folder.display()))?;
        left.folders.push(folder.clone());
        Ok(Self(folder))
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let mut left = left();
        remove(&self.0);
        left.folders.retain(|other| *other != self.0);
    }
}

fn remove(folder: &Path) {
    // Who wrote into it may still be writing while it ends.
    for _ in 0..50 {
        if std::fs::remove_dir_all(folder).is_ok() || !folder.exists() {
            return;
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn a_child_is_ended_with_those_that_it_started() {
        let scratch = Scratch::new("tombolo-lab-child").unwrap();
        let (note, folder) = (scratch.path().join("pid"), scratch.path().to_owned());
        let mut command = Command::new("sh");
        command.args(["-c", "sleep 600 & echo $! > \"$0.new\"; mv \"$0.new\" \"$0\"; wait"]).arg(&note);
        let guarded = Guarded::start(&mut command).unwrap();
        let deadline = Instant::now() + Duration::from_secs(10);
        while !note.exists() && Instant::now() < deadline {
            std::thread::sleep(LOOK_EVERY);
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
    fn a_child_that_runs_on_is_told_from_one_that_has_ended() {
        let mut runs = Guarded::start(Command::new("sleep").arg("600")).unwrap();
        assert_eq!(runs.ends_before(Instant::now()).unwrap(), None);
        let mut ends = Guarded::start(Command::new("false").stdin(Stdio::null())).unwrap();
        let status = ends.ends_before(Instant::now() + Duration::from_secs(10)).unwrap().unwrap();
        assert!(!status.success());
    }
}
