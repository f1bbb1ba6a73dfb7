//! The writer thread: writes, counts and evicts.
//!
//! Every shard has an equal share of the budget; names spread frames evenly over the shards, so
//! shards are independent. A shard over its share loses its oldest files, by modification time,
//! until an eighth of the share is free. Since every shard is a fair sample, these are nearly the
//! oldest of all; and no index in memory is needed.
//!
//! Shards are counted one by one while the queue is empty, and before the first write to them.
//! Reads do not wait for the count.
//!
//! If the folder is unavailable (full, read-only, removed, locked by another server), the thread
//! logs it once, drops writes, and retries every minute.

use super::names::{SHARDS, shard_name, shard_of};
use crate::metrics::Metrics;
use bytes::Bytes;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tokio::sync::mpsc::Receiver;
use tokio::sync::mpsc::error::TryRecvError;
use tokio::sync::oneshot;

/// Files occupy whole blocks of this size, bytes.
const BLOCK: u64 = 4096;

/// Interval between attempts to open an unavailable folder.
const RETRY_INTERVAL: Duration = Duration::from_secs(60);

/// Interval between two polls for a command while the folder is unavailable: an attempt may be due
/// though nothing is written, and the channel has no blocking receive with a timeout.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// Lock file of the server that uses the folder.
const LOCK_FILE: &str = "lock";

/// Temporary file of the current write. There is one writer, so the file that a crash leaves is
/// overwritten.
const TEMPORARY_FILE: &str = "unfinished";

/// Commands to the thread.
#[derive(Debug)]
pub enum WriterCommand {
    /// Write a frame.
    Write {
        /// Relative to the folder.
        path: PathBuf,
        /// Content of the file.
        frame: Bytes,
    },
    /// Delete an invalid file.
    Discard {
        /// Relative to the folder.
        path: PathBuf,
    },
    /// Release the folder after all earlier commands, confirm, and end.
    Close(oneshot::Sender<()>),
}

/// Folder and budget.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DiskConfig {
    /// The folder. Created if its parent exists; for one server at a time.
    pub folder: PathBuf,
    /// Budget in bytes, counted in blocks of 4 KiB.
    pub bytes: u64,
}

/// See the module.
pub struct DiskWriter {
    config: DiskConfig,
    metrics: Arc<Metrics>,
    /// Bytes by shard; none before its count.
    counts: Vec<Option<u64>>,
    /// The next shard to count after the folder was opened.
    next_to_count: usize,
    state: State,
    /// [`RETRY_INTERVAL`], shorter in tests.
    pub(super) retry_interval: Duration,
    /// Whether the folder was opened before. It is not created again then: a folder that disappears
    /// is most often a lost mount, and the disk under the mount point must not be filled.
    was_open: bool,
    /// Whether the outage is logged.
    is_outage_logged: bool,
}

enum State {
    /// With the lock.
    Open(#[expect(dead_code, reason = "held for its lock")] File),
    /// Not to be opened before this moment, if there is one.
    Unavailable(Option<Instant>),
}

impl DiskWriter {
    /// A writer that has not opened its folder.
    pub fn new(config: DiskConfig, metrics: Arc<Metrics>) -> Self {
        Self {
            config,
            metrics,
            counts: vec![None; SHARDS],
            next_to_count: 0,
            state: State::Unavailable(None),
            retry_interval: RETRY_INTERVAL,
            was_open: false,
            is_outage_logged: false,
        }
    }

    /// Executes commands until the channel closes.
    pub fn run(mut self, mut commands: Receiver<WriterCommand>) {
        self.try_open(Instant::now());
        loop {
            let command = if self.is_open() && !self.has_uncounted() {
                commands.blocking_recv()
            } else {
                match commands.try_recv() {
                    Ok(command) => Some(command),
                    Err(TryRecvError::Empty) if self.is_open() => {
                        self.count_next();
                        continue;
                    }
                    Err(TryRecvError::Empty) => {
                        std::thread::sleep(POLL_INTERVAL);
                        self.try_open(Instant::now());
                        continue;
                    }
                    Err(TryRecvError::Disconnected) => None,
                }
            };
            match command {
                Some(WriterCommand::Write { path, frame }) => self.write(&path, &frame, Instant::now()),
                Some(WriterCommand::Discard { path }) => self.discard(&path),
                Some(WriterCommand::Close(done)) => {
                    // Another server may lock the folder from here on, so no further command is
                    // accepted.
                    drop((self, commands));
                    // The receiver may have timed out.
                    let _ = done.send(());
                    return;
                }
                None => return,
            }
        }
    }

    /// Writes one frame, or drops it.
    pub fn write(&mut self, path: &Path, frame: &[u8], now: Instant) {
        self.try_open(now);
        if !self.is_open() {
            self.metrics.disk_cache.dropped.inc();
        } else if let Err(error) = self.store(path, frame) {
            self.metrics.disk_cache.dropped.inc();
            match error.kind() {
                // A folder in the place of a file affects one frame only.
                io::ErrorKind::IsADirectory | io::ErrorKind::DirectoryNotEmpty => {
                    self.metrics.disk_cache.io_errors.inc();
                }
                _ => self.mark_unavailable(&error, now),
            }
        } else {
            self.metrics.disk_cache.writes.inc();
        }
        self.update_size_metric();
    }

    /// Deletes an invalid file. Here, not where it is found, so that it is counted once.
    pub fn discard(&mut self, path: &Path) {
        let full_path = self.config.folder.join(path);
        let bytes = size_at(&full_path);
        // If it cannot be deleted, a write replaces it, or it is rejected again. A folder is
        // deleted only if it is empty.
        if fs::remove_file(&full_path).or_else(|_| fs::remove_dir(&full_path)).is_ok() {
            self.subtract(shard_of(path), bytes);
        }
        self.update_size_metric();
    }

    /// Counts the next shard.
    pub fn count_next(&mut self) {
        let shard = self.next_to_count;
        self.next_to_count += 1;
        if self.counts[shard].is_none()
            && let Err(error) = self.count(shard)
        {
            self.mark_unavailable(&error, Instant::now());
        }
        self.update_size_metric();
    }

    /// Whether a shard is not counted yet.
    pub fn has_uncounted(&self) -> bool {
        self.is_open() && self.next_to_count < SHARDS
    }

    fn is_open(&self) -> bool {
        matches!(self.state, State::Open(_))
    }

    fn store(&mut self, path: &Path, frame: &[u8]) -> io::Result<()> {
        let (folder, shard) = (&self.config.folder, shard_of(path));
        let (temporary, path) = (folder.join(TEMPORARY_FILE), folder.join(path));
        fs::write(&temporary, frame).inspect_err(|_| {
            // On a full disk it would occupy the last blocks.
            let _ = fs::remove_file(&temporary);
        })?;
        let replaced = size_at(&path);
        if let Err(error) = fs::rename(&temporary, &path) {
            if error.kind() != io::ErrorKind::NotFound {
                return Err(error);
            }
            fs::create_dir(folder.join(shard_name(shard)))?;
            fs::rename(&temporary, &path)?;
        }
        self.subtract(shard, replaced);
        match &mut self.counts[shard] {
            Some(bytes) => *bytes += size(frame.len() as u64),
            None => return self.count(shard),
        }
        self.evict_to_share(shard)
    }

    /// A file of a counted shard is gone.
    fn subtract(&mut self, shard: usize, gone: u64) {
        if let Some(bytes) = &mut self.counts[shard] {
            *bytes = bytes.saturating_sub(gone);
        }
    }

    /// Counts the bytes of a shard.
    fn count(&mut self, shard: usize) -> io::Result<()> {
        let mut bytes = 0;
        self.for_each_file(shard, |_, metadata| bytes += size(metadata.len()))?;
        self.counts[shard] = Some(bytes);
        self.evict_to_share(shard)
    }

    /// Deletes the oldest files of a shard that is over its share.
    fn evict_to_share(&mut self, shard: usize) -> io::Result<()> {
        let share = self.config.bytes / SHARDS as u64;
        if self.counts[shard].is_none_or(|bytes| bytes <= share) {
            return Ok(());
        }
        let (mut files, mut bytes) = (Vec::new(), 0);
        self.for_each_file(shard, |path, metadata| {
            bytes += size(metadata.len());
            files.push((metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH), size(metadata.len()), path));
        })?;
        files.sort_unstable();
        for (_, size, path) in files {
            if bytes <= share - share / 8 {
                break;
            }
            match fs::remove_file(path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {
                    bytes -= size;
                    self.metrics.disk_cache.evictions.inc();
                }
            }
        }
        self.counts[shard] = Some(bytes);
        Ok(())
    }

    fn for_each_file(&self, shard: usize, mut each: impl FnMut(PathBuf, &fs::Metadata)) -> io::Result<()> {
        let entries = match fs::read_dir(self.config.folder.join(shard_name(shard))) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(error),
        };
        for entry in entries {
            let entry = entry?;
            match entry.metadata() {
                Ok(metadata) if metadata.is_file() => each(entry.path(), &metadata),
                // A foreign entry, or a file just deleted by the reader.
                _ => {}
            }
        }
        Ok(())
    }

    /// Opens the folder unless it is open or the next attempt is later.
    pub fn try_open(&mut self, now: Instant) {
        let State::Unavailable(until) = self.state else { return };
        if until.is_some_and(|until| now < until) {
            return;
        }
        match self.open() {
            Ok(lock) => {
                self.state = State::Open(lock);
                (self.was_open, self.next_to_count) = (true, 0);
                self.counts.fill(None);
                self.metrics.disk_cache.up.set(1);
                if self.is_outage_logged {
                    let folder = self.config.folder.display();
                    tracing::info!(%folder, "the disk cache is available again");
                }
                self.is_outage_logged = false;
            }
            Err(error) => self.mark_unavailable(&error, now),
        }
    }

    fn open(&self) -> io::Result<File> {
        let folder = &self.config.folder;
        // Not its parents: they may be missing with a lost mount, and the disk under it must not be
        // filled.
        if !self.was_open && !folder.is_dir() {
            match fs::create_dir(folder) {
                // Created by another process since the check.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists && folder.is_dir() => {}
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    return Err(io::Error::new(error.kind(), "its parent folder does not exist"));
                }
                created => created?,
            }
        }
        let lock =
            OpenOptions::new().create(true).truncate(false).write(true).open(folder.join(LOCK_FILE))?;
        match lock.try_lock() {
            Ok(()) => Ok(lock),
            Err(TryLockError::WouldBlock) => Err(io::Error::other("another server has locked it")),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }

    fn mark_unavailable(&mut self, error: &io::Error, now: Instant) {
        self.state = State::Unavailable(Some(now + self.retry_interval));
        self.metrics.disk_cache.up.set(0);
        self.metrics.disk_cache.io_errors.inc();
        if !self.is_outage_logged {
            let folder = self.config.folder.display();
            tracing::warn!(%folder, %error, "the disk cache is unavailable; retrying every minute");
        }
        self.is_outage_logged = true;
    }

    fn update_size_metric(&self) {
        let bytes: u64 = self.counts.iter().flatten().sum();
        self.metrics.disk_cache.bytes.set(bytes as i64);
    }
}

/// Size on disk of the file at a path, bytes; 0 if there is none.
fn size_at(path: &Path) -> u64 {
    fs::symlink_metadata(path).ok().filter(fs::Metadata::is_file).map_or(0, |metadata| size(metadata.len()))
}

/// Size on disk of a file, bytes.
const fn size(bytes: u64) -> u64 {
    bytes.next_multiple_of(BLOCK)
}
