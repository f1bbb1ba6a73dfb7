//! The one thread that reads, so that nobody else waits for a disk without end.
//!
//! A file system may be slow, or hang for ever when it is another machine's. Whoever asks waits
//! until a deadline and then makes the chunk; from then on nobody asks at all until the read that
//! was too slow has ended. So a hanging disk costs one wait a generation thread, and one thread.

use crate::metrics::Metrics;
use protocol::limits::MAX_CHUNK_FRAME;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, SystemTime};

/// The longest wait for a read: longer than any that a working disk takes, on a busy machine too.
const DEADLINE: Duration = Duration::from_millis(250);

/// Reads that may wait for the thread; one more is a miss. More than generation threads of most
/// machines, and each has at most one.
const WAITING: usize = 64;

/// A file's time is moved on by a read only when it is older than this, so that a popular chunk
/// does not cost a write a read.
pub(super) const AGE_STEP: Duration = Duration::from_secs(3600);

/// One read, with where the bytes go. Who asked may have left.
type Request = (PathBuf, SyncSender<io::Result<Vec<u8>>>);

/// See the module.
#[derive(Debug)]
pub struct Reader {
    requests: SyncSender<Request>,
    /// Whether a read took too long and is not done yet.
    is_stuck: Arc<AtomicBool>,
    metrics: Arc<Metrics>,
}

impl Reader {
    /// Starts the thread. It ends with the reader, or with a read that never does.
    ///
    /// # Errors
    /// The system refuses to start a thread.
    pub fn new(metrics: Arc<Metrics>) -> io::Result<Self> {
        Self::by(load, metrics)
    }

    /// As [`Reader::new`], reading in another way.
    fn by(
        load: impl Fn(&Path) -> io::Result<Vec<u8>> + Send + 'static,
        metrics: Arc<Metrics>,
    ) -> io::Result<Self> {
        let (requests, requested) = sync_channel(WAITING);
        let is_stuck = Arc::new(AtomicBool::new(false));
        let stuck = Arc::clone(&is_stuck);
        std::thread::Builder::new().name("disk-read".into()).spawn(move || run(&load, &requested, &stuck))?;
        Ok(Self { requests, is_stuck, metrics })
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// What the system says; [`ErrorKind::TimedOut`] if it takes too long, and at once while
    /// another read does; [`ErrorKind::InvalidData`] if there is something that is no file.
    pub fn read(&self, path: PathBuf) -> io::Result<Vec<u8>> {
        if self.is_stuck.load(Ordering::Acquire) {
            return Err(ErrorKind::TimedOut.into());
        }
        let (answer, answered) = sync_channel(1);
        if self.requests.try_send((path, answer)).is_err() {
            return Err(ErrorKind::TimedOut.into());
        }
        answered.recv_timeout(DEADLINE).unwrap_or_else(|_| {
            self.is_stuck.store(true, Ordering::Release);
            // The thread may have answered between the wait and the note; then the note would stay.
            // Its answer is there to be seen.
            let answer = answered.try_recv();
            if answer.is_ok() {
                self.is_stuck.store(false, Ordering::Release);
            }
            self.metrics.disk_slow.inc();
            answer.unwrap_or_else(|_| Err(ErrorKind::TimedOut.into()))
        })
    }
}

fn run(load: &impl Fn(&Path) -> io::Result<Vec<u8>>, requested: &Receiver<Request>, is_stuck: &AtomicBool) {
    while let Ok((path, answer)) = requested.recv() {
        // An answer that nobody waits for any more is no error.
        let _ = answer.try_send(load(&path));
        is_stuck.store(false, Ordering::Release);
    }
}

/// Opens a file, and what only looks like one in no time: a pipe without a writer would keep
/// whoever opens it, and a link leads out of the folder.
fn open(path: &Path) -> io::Result<File> {
    let mut options = File::options();
    options.read(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK | libc::O_NOFOLLOW);
    let opened = options.open(path);
    // What a link and a socket say.
    #[cfg(unix)]
    let opened = opened.map_err(|error| match error.raw_os_error() {
        Some(libc::ELOOP | libc::ENXIO) => ErrorKind::InvalidData.into(),
        _ => error,
    });
    opened
}

/// The bytes of a file, and a note that it is in use. A longer file than any frame is read no
/// further than to be seen as one.
pub(super) fn load(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = open(path)?;
    let about = file.metadata()?;
    if !about.is_file() {
        return Err(ErrorKind::InvalidData.into());
    }
    let mut bytes = Vec::with_capacity((about.len() as usize).min(MAX_CHUNK_FRAME) + 1);
    file.by_ref().take(MAX_CHUNK_FRAME as u64 + 1).read_to_end(&mut bytes)?;
    let now = SystemTime::now();
    // A time in the future is as wrong as an old one.
    if about.modified().ok().is_none_or(|then| now.duration_since(then).is_ok_and(|age| age < AGE_STEP)) {
        return Ok(bytes);
    }
    // Where times cannot be set, frames go by the age of their writing.
    let _ = file.set_modified(now);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn a_disk_that_hangs_costs_one_wait_and_is_used_again_when_it_answers() {
        let (release, released) = channel::<()>();
        let metrics = Arc::new(Metrics::default());
        let load = move |path: &Path| {
            if path.ends_with("hanging") {
                released.recv().unwrap();
            }
            Ok(vec![7])
        };
        let reader = Reader::by(load, Arc::clone(&metrics)).unwrap();
        assert_eq!(reader.read("good".into()).unwrap(), [7]);
        let late =
            |path: &str| reader.read(path.into()).is_err_and(|error| error.kind() == ErrorKind::TimedOut);
        assert!(late("hanging"));
        for _ in 0..1000 {
            assert!(late("good"), "nobody waits behind it");
        }
        assert_eq!(metrics.disk_slow.get(), 1);
        release.send(()).unwrap();
        let again = (0..10_000).any(|_| {
            std::thread::sleep(Duration::from_millis(1));
            !late("good")
        });
        assert!(again);
    }
}
