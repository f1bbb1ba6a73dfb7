//! A control group of Linux with a hard limit of memory: version 2, or the memory controller of
//! version 1 (kernel documentation, admin-guide/cgroup-v2 and cgroup-v1/memory).

use anyhow::{Context, Result, ensure};
use std::fs;
use std::path::{Path, PathBuf};

const ROOT: &str = "/sys/fs/cgroup";

/// A control group, removed when dropped. Its processes must have ended by then.
#[derive(Debug)]
pub struct Cgroup {
    folder: PathBuf,
    files: &'static Files,
}

/// Names of the files of a version.
#[derive(Debug)]
struct Files {
    limit: &'static str,
    peak: &'static str,
    /// A file with lines of a name and a number, and the name of the processes that were killed.
    events: &'static str,
}

const V1: Files =
    Files { limit: "memory.limit_in_bytes", peak: "memory.max_usage_in_bytes", events: "memory.oom_control" };

const V2: Files = Files { limit: "memory.max", peak: "memory.peak", events: "memory.events" };

impl Cgroup {
    /// A group whose processes may use `limit_bytes` of memory together.
    ///
    /// # Errors
    /// Linux only, and only by a user who may create groups.
    pub fn new(limit_bytes: u64) -> Result<Self> {
        let is_v2 = Path::new(ROOT).join("cgroup.controllers").exists();
        let (parent, files) =
            if is_v2 { (PathBuf::from(ROOT), &V2) } else { (Path::new(ROOT).join("memory"), &V1) };
        ensure!(parent.is_dir(), "no control groups for memory in {ROOT}: they need Linux");
        let folder = parent.join(format!("tombolo-{}", std::process::id()));
        fs::create_dir(&folder)
            .with_context(|| format!("cannot create {}: run this as root", folder.display()))?;
        let group = Self { folder, files };
        group.write(files.limit, limit_bytes)?;
        Ok(group)
    }

    /// The folder, for processes that join it.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The most memory that was used at once, bytes.
    pub fn peak_bytes(&self) -> Result<u64> {
        self.read(self.files.peak)?.trim().parse().context("peak of the control group")
    }

    /// Processes that were killed because the limit was reached.
    pub fn killed(&self) -> Result<u64> {
        let events = self.read(self.files.events)?;
        let killed = events.lines().find_map(|line| line.strip_prefix("oom_kill ")?.trim().parse().ok());
        killed.context("the control group does not count killed processes")
    }

    fn write(&self, file: &str, value: u64) -> Result<()> {
        let path = self.folder.join(file);
        fs::write(&path, value.to_string()).with_context(|| format!("cannot write {}", path.display()))
    }

    fn read(&self, file: &str) -> Result<String> {
        let path = self.folder.join(file);
        fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    }
}

impl Drop for Cgroup {
    fn drop(&mut self) {
        let _ = fs::remove_dir(&self.folder);
    }
}
