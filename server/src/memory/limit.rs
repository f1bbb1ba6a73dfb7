//! The memory that this process may use: the least limit of its control groups, or else the memory
//! of the machine. Linux only; elsewhere it is not known.
//!
//! Sources: proc(5), cgroups(7), and the kernel's documentation of control groups, version 2
//! (`memory.max`, `memory.current`) and version 1 (`memory.limit_in_bytes`,
//! `memory.usage_in_bytes`). A limit of any group above that of the process applies to it too.

use std::cell::RefCell;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fmt;
use std::fs::File;
use std::io::{Read as _, Seek};
use std::path::{Path, PathBuf};

/// Reads a file; none if it cannot be read.
type Read<'a> = &'a dyn Fn(&Path) -> Option<String>;

/// Names in a version of control groups.
#[derive(Debug, PartialEq, Eq)]
struct Version {
    filesystem: &'static str,
    limit: &'static str,
    usage: &'static str,
    /// Lines of `memory.stat`: pages of files, and those of them that are memory shared by
    /// processes, which is never written back.
    files: &'static str,
    shared: &'static str,
}

const V2: Version = Version {
    filesystem: "cgroup2",
    limit: "memory.max",
    usage: "memory.current",
    files: "file",
    shared: "shmem",
};

const V1: Version = Version {
    filesystem: "cgroup",
    limit: "memory.limit_in_bytes",
    usage: "memory.usage_in_bytes",
    files: "total_cache",
    shared: "total_shmem",
};

/// The memory that the process may use, and where that is said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemoryLimit {
    bytes: u64,
    /// The control group whose limit it is; none for the memory of the machine.
    group: Option<Group>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Group {
    folder: PathBuf,
    version: &'static Version,
}

impl MemoryLimit {
    /// That of this process; none where the system does not say it.
    #[must_use]
    pub fn of_process() -> Option<Self> {
        Self::from_files(&|path| std::fs::read_to_string(path).ok())
    }

    /// The memory of a machine without a limit.
    #[must_use]
    pub const fn of_machine(bytes: u64) -> Self {
        Self { bytes, group: None }
    }

    /// The limit of a control group, version 2, bytes, whatever its folder says.
    #[must_use]
    pub const fn of_group(folder: PathBuf, bytes: u64) -> Self {
        Self { bytes, group: Some(Group { folder, version: &V2 }) }
    }

    fn from_files(read: Read<'_>) -> Option<Self> {
        let machine = field(&read(Path::new("/proc/meminfo"))?, "MemTotal:")? * 1024;
        let mut least = Self::of_machine(machine);
        let groups = read(Path::new("/proc/self/cgroup")).unwrap_or_default();
        let mounts = read(Path::new("/proc/self/mountinfo")).unwrap_or_default();
        for (folder, version) in folders(&groups, &mounts) {
            // A group without a limit says `max`, or more than any machine has.
            let limit = read(&folder.join(version.limit)).and_then(|text| text.trim().parse().ok());
            if let Some(bytes) = limit.filter(|bytes| *bytes < least.bytes) {
                least = Self { bytes, group: Some(Group { folder, version }) };
            }
        }
        Some(least)
    }

    /// The limit, bytes.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The memory in use that counts against the limit, bytes: that of all processes of the group,
    /// or that of this process. Pages of files and caches of the kernel do not count, since the
    /// system takes them back; version 1 does not say how much the latter are.
    #[must_use]
    pub fn used_bytes(&self, files: &OpenFiles) -> Option<u64> {
        self.used(&|path| files.read(path))
    }

    fn used(&self, read: Read<'_>) -> Option<u64> {
        let Some(Group { folder, version }) = &self.group else {
            return Some(field(&read(Path::new("/proc/self/status"))?, "VmRSS:")? * 1024);
        };
        let usage: u64 = read(&folder.join(version.usage))?.trim().parse().ok()?;
        let stat = read(&folder.join("memory.stat"))?;
        let files = field(&stat, version.files)?.saturating_sub(field(&stat, version.shared).unwrap_or(0));
        let caches = field(&stat, "slab_reclaimable").unwrap_or(0);
        Some(usage.saturating_sub(files).saturating_sub(caches))
    }
}

/// Files that stay open: memory must be known also when peers have taken all file descriptors.
#[derive(Debug, Default)]
pub struct OpenFiles(RefCell<HashMap<PathBuf, File>>);

impl OpenFiles {
    fn read(&self, path: &Path) -> Option<String> {
        let mut files = self.0.borrow_mut();
        let file = match files.entry(path.to_owned()) {
            Entry::Occupied(file) => file.into_mut(),
            Entry::Vacant(entry) => entry.insert(File::open(path).ok()?),
        };
        let mut text = String::new();
        if file.rewind().and_then(|()| file.read_to_string(&mut text)).is_ok() {
            return Some(text);
        }
        // Of a group that was removed and made again: the next read opens it.
        files.remove(path);
        None
    }
}

impl fmt::Display for MemoryLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} MiB, ", self.bytes >> 20)?;
        match &self.group {
            Some(group) => write!(f, "{}", group.folder.join(group.version.limit).display()),
            None => f.write_str("memory of the machine"),
        }
    }
}

/// The number behind a name at the begin of a line.
fn field(text: &str, name: &str) -> Option<u64> {
    text.lines().find_map(|line| {
        let mut words = line.split_whitespace();
        (words.next()? == name).then(|| words.next()?.parse().ok())?
    })
}

/// The folders of the groups that the process is in and of all above them that it can see.
fn folders(groups: &str, mounts: &str) -> Vec<(PathBuf, &'static Version)> {
    let mut found = Vec::new();
    for line in groups.lines() {
        let mut parts = line.splitn(3, ':');
        let (Some(_), Some(controllers), Some(path)) = (parts.next(), parts.next(), parts.next()) else {
            continue;
        };
        let version = match controllers {
            "" => &V2,
            _ if controllers.split(',').any(|name| name == "memory") => &V1,
            _ => continue,
        };
        for (root, mounted) in mounts.lines().filter_map(|line| mount(line, version)) {
            // In a container the mount may show a part of the tree only: then its root is the
            // group.
            let below = Path::new(path).strip_prefix(&root).unwrap_or(Path::new(""));
            found.extend(below.ancestors().map(|folder| (mounted.join(folder), version)));
        }
    }
    found
}

/// The root and the place of a mount of control groups with a controller for memory.
fn mount(line: &str, version: &Version) -> Option<(PathBuf, PathBuf)> {
    let (place, filesystem) = line.split_once(" - ")?;
    let mut place = place.split(' ').skip(3);
    let (root, mounted) = (place.next()?, place.next()?);
    let mut filesystem = filesystem.split(' ');
    if filesystem.next()? != version.filesystem {
        return None;
    }
    let has_memory = |options: &str| options.split(',').any(|option| option == "memory");
    let is_ours = *version == V2 || filesystem.nth(1).is_some_and(has_memory);
    // Spaces are written as `\040`; other escapes are of characters that no one uses there.
    let path = |text: &str| PathBuf::from(text.replace("\\040", " "));
    is_ours.then(|| (path(root), path(mounted)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    const MEMINFO: (&str, &str) = ("/proc/meminfo", "MemTotal:       4194304 kB\nMemFree: 1 kB\n");

    fn limit_of(files: &[(&str, &str)]) -> Option<MemoryLimit> {
        MemoryLimit::from_files(&reader(files))
    }

    fn reader(files: &[(&str, &str)]) -> impl Fn(&Path) -> Option<String> {
        let files: HashMap<PathBuf, String> =
            files.iter().map(|(path, text)| (path.into(), (*text).to_owned())).collect();
        move |path| files.get(path).cloned()
    }

    #[test]
    fn without_groups_it_is_the_memory_of_the_machine() {
        let limit = limit_of(&[MEMINFO]).unwrap();
        assert_eq!(limit, MemoryLimit::of_machine(4 << 30));
        assert_eq!(limit.to_string(), "4096 MiB, memory of the machine");
        let status = [("/proc/self/status", "VmPeak:\t  900 kB\nVmRSS:\t    2048 kB\n")];
        assert_eq!(limit.used(&reader(&status)), Some(2 << 20));
        assert_eq!(limit.used(&reader(&[])), None);
        assert_eq!(limit_of(&[]), None);
    }

    #[test]
    fn the_least_limit_of_a_group_or_one_above_it_applies() {
        let group = ("/proc/self/cgroup", "0::/system.slice/map.service\n");
        let mounts = (
            "/proc/self/mountinfo",
            "25 30 0:23 / /sys rw - sysfs sysfs rw\n\
             31 25 0:27 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n",
        );
        let slice = ("/sys/fs/cgroup/system.slice/memory.max", "536870912\n");
        let service = "/sys/fs/cgroup/system.slice/map.service/memory.max";
        let limit = limit_of(&[MEMINFO, group, mounts, slice, (service, "max\n")]).unwrap();
        assert_eq!(limit.bytes(), 512 << 20);
        assert_eq!(limit.to_string(), "512 MiB, /sys/fs/cgroup/system.slice/memory.max");
        let usage = [
            ("/sys/fs/cgroup/system.slice/memory.current", "104857600\n"),
            (
                "/sys/fs/cgroup/system.slice/memory.stat",
                "file 20971520\nshmem 10485760\nslab_reclaimable 1048576\n",
            ),
        ];
        assert_eq!(limit.used(&reader(&usage)), Some(89 << 20));
        let limit = limit_of(&[MEMINFO, group, mounts, slice, (service, "1048576\n")]).unwrap();
        assert_eq!(limit.bytes(), 1 << 20);
        // More than the machine has is no limit.
        let limit = limit_of(&[MEMINFO, group, mounts, (service, "9999999999999\n")]).unwrap();
        assert_eq!(limit, MemoryLimit::of_machine(4 << 30));
    }

    #[test]
    fn version_1_has_a_mount_for_its_controller() {
        let group = ("/proc/self/cgroup", "9:name=systemd:/a\n4:cpu,cpuacct:/b\n3:memory:/m/n\n0::/\n");
        let mounts = (
            "/proc/self/mountinfo",
            "40 32 0:35 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu,cpuacct\n\
             41 32 0:36 / /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory\n\
             42 32 0:37 / /sys/fs/cgroup/unified rw - cgroup2 cgroup2 rw\n",
        );
        let files = [
            MEMINFO,
            group,
            mounts,
            ("/sys/fs/cgroup/memory/m/n/memory.limit_in_bytes", "9223372036854771712\n"),
            ("/sys/fs/cgroup/memory/m/memory.limit_in_bytes", "67108864\n"),
            ("/sys/fs/cgroup/memory/m/memory.usage_in_bytes", "7000\n"),
            ("/sys/fs/cgroup/memory/m/memory.stat", "cache 1\ntotal_cache 3000\ntotal_shmem 1000\n"),
        ];
        let limit = limit_of(&files).unwrap();
        assert_eq!(limit.bytes(), 64 << 20);
        assert_eq!(limit.used(&reader(&files)), Some(5000));
    }

    #[test]
    fn a_mount_of_a_part_of_the_tree_is_the_group_itself() {
        let files = [
            MEMINFO,
            ("/proc/self/cgroup", "0::/../other\n"),
            ("/proc/self/mountinfo", "31 25 0:27 /pod/box /sys/fs/c\\040g rw - cgroup2 cgroup rw\n"),
            ("/sys/fs/c g/memory.max", "1048576"),
        ];
        assert_eq!(limit_of(&files).unwrap().bytes(), 1 << 20);
    }

    #[test]
    fn this_process_has_a_limit_on_linux() {
        let limit = MemoryLimit::of_process();
        assert_eq!(limit.is_some(), cfg!(target_os = "linux"));
        if let Some(limit) = limit {
            assert!(
                limit
                    .used_bytes(&OpenFiles::default())
                    .is_some_and(|used| (1 << 20..limit.bytes()).contains(&used)),
                "{limit}"
            );
        }
    }
}
