//! The reader thread, which bounds the wait for a slow disk.
//!
//! A network file system may block forever. A generation thread waits until a deadline and then
//! generates the chunk; further reads fail at once until the blocked read has returned. So a
//! blocked disk costs each generation thread one timeout.

use crate::metrics::Metrics;
use protocol::limits::MAX_CHUNK_FRAME;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, SystemTime};

/// Timeout of a read: longer than a read from a working disk on a busy machine.
const READ_TIMEOUT: Duration = Duration::from_millis(250);

/// Capacity of the read queue; one more read is a miss. Each generation thread has one read at
/// most.
const READ_QUEUE: usize = 64;

/// A read updates a file's modification time only if it is older than this, so that a popular chunk
/// does not cost a write per read.
pub(super) const TOUCH_INTERVAL: Duration = Duration::from_secs(3600);

/// A path, and the sender of its content.
type ReadRequest = (PathBuf, SyncSender<io::Result<Vec<u8>>>);

/// See the module.
#[derive(Debug)]
pub struct Reader {
    requests: SyncSender<ReadRequest>,
    /// Whether a timed-out read has not returned yet.
    is_blocked: Arc<AtomicBool>,
    metrics: Arc<Metrics>,
}

impl Reader {
    /// Starts the thread. It ends after the reader is dropped.
    ///
    /// # Errors
    /// The system cannot start a thread.
    pub fn new(metrics: Arc<Metrics>) -> io::Result<Self> {
        Self::with(load, metrics)
    }

    /// As [`Reader::new`], with another function that reads.
    fn with(
        load: impl Fn(&Path) -> io::Result<Vec<u8>> + Send + 'static,
        metrics: Arc<Metrics>,
    ) -> io::Result<Self> {
        let (requests, receiver) = sync_channel(READ_QUEUE);
        let is_blocked = Arc::new(AtomicBool::new(false));
        let blocked = Arc::clone(&is_blocked);
        std::thread::Builder::new()
            .name("disk-read".into())
            .spawn(move || run(&load, &receiver, &blocked))?;
        Ok(Self { requests, is_blocked, metrics })
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// Errors of the system; [`ErrorKind::TimedOut`] after the timeout, and at once while another
    /// read is blocked; [`ErrorKind::InvalidData`] if the path is no regular file.
    pub fn read(&self, path: PathBuf) -> io::Result<Vec<u8>> {
        if self.is_blocked.load(Ordering::Acquire) {
            return Err(ErrorKind::TimedOut.into());
        }
        let (sender, result) = sync_channel(1);
        if self.requests.try_send((path, sender)).is_err() {
            return Err(ErrorKind::TimedOut.into());
        }
        result.recv_timeout(READ_TIMEOUT).unwrap_or_else(|_| {
            self.is_blocked.store(true, Ordering::Release);
            // The read may have returned between the timeout and the store; the flag would stay set
            // then.
            let late = result.try_recv();
            if late.is_ok() {
                self.is_blocked.store(false, Ordering::Release);
            }
            self.metrics.disk_cache.timeouts.inc();
            late.unwrap_or_else(|_| Err(ErrorKind::TimedOut.into()))
        })
    }
}

fn run(
    load: &impl Fn(&Path) -> io::Result<Vec<u8>>,
    receiver: &Receiver<ReadRequest>,
    is_blocked: &AtomicBool,
) {
    while let Ok((path, sender)) = receiver.recv() {
        // The receiver may have timed out.
        let _ = sender.try_send(load(&path));
        is_blocked.store(false, Ordering::Release);
    }
}

/// Opens a file without blocking on a pipe that has no writer, and without following a link out of
/// the folder.
fn open(path: &Path) -> io::Result<File> {
    let mut options = File::options();
    options.read(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK | libc::O_NOFOLLOW);
    let opened = options.open(path);
    // The errors for a link and for a socket.
    #[cfg(unix)]
    let opened = opened.map_err(|error| match error.raw_os_error() {
        Some(libc::ELOOP | libc::ENXIO) => ErrorKind::InvalidData.into(),
        _ => error,
    });
    opened
}

/// The content of a file; updates its modification time, by which files are evicted. A file longer
/// than any frame is read up to one byte over that length.
pub(super) fn load(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Err(ErrorKind::InvalidData.into());
    }
    let mut bytes = Vec::with_capacity((metadata.len() as usize).min(MAX_CHUNK_FRAME) + 1);
    file.by_ref().take(MAX_CHUNK_FRAME as u64 + 1).read_to_end(&mut bytes)?;
    let now = SystemTime::now();
    // A time in the future is updated too.
    if metadata
        .modified()
        .ok()
        .is_none_or(|then| now.duration_since(then).is_ok_and(|age| age < TOUCH_INTERVAL))
    {
        return Ok(bytes);
    }
    // Without permission to set times, files are evicted by the time of their write.
    let _ = file.set_modified(now);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn a_blocked_disk_costs_one_timeout_and_recovers() {
        let (release, released) = channel::<()>();
        let metrics = Arc::new(Metrics::default());
        let load = move |path: &Path| {
            if path.ends_with("blocked") {
                released.recv().unwrap();
            }
            Ok(vec![7])
        };
        let reader = Reader::with(load, Arc::clone(&metrics)).unwrap();
        assert_eq!(reader.read("good".into()).unwrap(), [7]);
        let late =
            |path: &str| reader.read(path.into()).is_err_and(|error| error.kind() == ErrorKind::TimedOut);
        assert!(late("blocked"));
        for _ in 0..1000 {
            assert!(late("good"), "fails at once");
        }
        assert_eq!(metrics.disk_cache.timeouts.get(), 1);
        release.send(()).unwrap();
        let again = (0..10_000).any(|_| {
            std::thread::sleep(Duration::from_millis(1));
            !late("good")
        });
        assert!(again);
    }
}
