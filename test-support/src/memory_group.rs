//! A folder with the files of a control group, version 2, that says how much memory is in use.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// See the module. The folder is removed on drop.
#[derive(Debug)]
pub struct MemoryGroup {
    folder: PathBuf,
    usage: File,
}

impl MemoryGroup {
    /// A group whose processes use so much memory, bytes.
    ///
    /// # Errors
    /// The folder of temporary files cannot be written.
    pub fn new(used: u64) -> io::Result<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("tombolo-group-{}-{number}", std::process::id()));
        // Of a process with the same number that was killed.
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir(&folder)?;
        fs::write(folder.join("memory.stat"), "file 0\n")?;
        let usage = File::create(folder.join("memory.current"))?;
        let group = Self { folder, usage };
        group.set_used(used)?;
        Ok(group)
    }

    /// The folder of the group.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Sets the memory in use, bytes. A reader sees this or the earlier figure: each has as many
    /// digits.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn set_used(&self, used: u64) -> io::Result<()> {
        self.usage.write_all_at(format!("{used:020}\n").as_bytes(), 0)
    }
}

impl Drop for MemoryGroup {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}
