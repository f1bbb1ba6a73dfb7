//! Tests of the disk cache without a server. Every test has its own folder; the tests of the writer
//! pass the time themselves.

use super::*;
use crate::cache::disk::reader::{TOUCH_INTERVAL, load};
use crate::cache::disk::writer::DiskWriter;
use protocol::chunk_codec;
use protocol::limits::MAX_CHUNK_FRAME;
use std::fs;
use std::fs::File;
use std::io::Write;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Instant, SystemTime};
use terrain::ChunkKey;

const WORLD: WorldDigest = WorldDigest([7; 32]);

/// A folder per test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self(std::env::temp_dir().join(format!("tombolo-disk-{}-{number}", std::process::id())))
    }

    fn config(&self, bytes: u64) -> DiskConfig {
        DiskConfig { folder: self.0.clone(), bytes }
    }

    fn path(&self, id: ChunkId) -> PathBuf {
        self.0.join(FrameNames::new(&WORLD).path(id, Delivery::Exact))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn id(x: i32) -> ChunkId {
    ChunkId::base(ChunkKey::new(2, x, -5).unwrap())
}

fn frame(x: i32) -> Bytes {
    Bytes::from(format!("frame {x}"))
}

/// A cache with its threads.
fn disk(folder: &Folder) -> (Disk, Arc<Metrics>) {
    let metrics = Arc::new(Metrics::default());
    (Disk::new(folder.config(1 << 30), &WORLD, Arc::clone(&metrics)).unwrap(), metrics)
}

/// A writer without its thread.
fn writer(folder: &Folder, bytes: u64) -> (DiskWriter, Arc<Metrics>) {
    let metrics = Arc::new(Metrics::default());
    (DiskWriter::new(folder.config(bytes), Arc::clone(&metrics)), metrics)
}

fn put(writer: &mut DiskWriter, x: i32, now: Instant) {
    writer.write(&FrameNames::new(&WORLD).path(id(x), Delivery::Exact), &frame(x), now);
}

fn files(folder: &Folder) -> Vec<PathBuf> {
    let shards = fs::read_dir(&folder.0).unwrap().map(|entry| entry.unwrap().path());
    let shards = shards.filter(|path| path.is_dir());
    shards.flat_map(|shard| fs::read_dir(shard).unwrap().map(|entry| entry.unwrap().path())).collect()
}

#[tokio::test]
async fn a_frame_is_read_after_a_restart_under_its_name_only() {
    let folder = Folder::new();
    let (first, metrics) = disk(&folder);
    first.write(id(1), Delivery::Exact, frame(1));
    first.close().await;
    assert_eq!((metrics.disk_cache.writes.get(), metrics.disk_cache.up.get()), (1, 1));
    first.write(id(3), Delivery::Exact, frame(3));
    assert_eq!(metrics.disk_cache.dropped.get(), 1, "another server may have locked the folder");

    let (second, metrics) = disk(&folder);
    // Its thread counts the file though nothing is written.
    while metrics.disk_cache.bytes.get() != 4096 {
        std::thread::yield_now();
    }
    assert_eq!(second.read(id(1), Delivery::Exact, |bytes| bytes == frame(1)), Some(frame(1)));
    assert_eq!(second.read(id(2), Delivery::Exact, |_| true), None);
    assert_eq!(second.read(id(1), Delivery::SeedOnly, |_| true), None);
    assert_eq!((metrics.disk_cache.hits.get(), metrics.disk_cache.misses.get()), (1, 2));
    let elsewhere = Disk::new(folder.config(1 << 30), &WorldDigest([8; 32]), metrics).unwrap();
    assert_eq!(elsewhere.read(id(1), Delivery::Exact, |_| true), None);
}

#[test]
fn a_folder_without_a_parent_is_not_created_before_its_parent_is() {
    let parent = Folder::new();
    let folder = Folder(parent.0.join("cache"));
    let (mut writer, metrics) = writer(&folder, 1 << 30);
    let now = Instant::now();
    put(&mut writer, 1, now);
    assert!(!parent.0.exists(), "the disk under a lost mount");
    assert_eq!((metrics.disk_cache.up.get(), metrics.disk_cache.dropped.get()), (0, 1));
    fs::create_dir(&parent.0).unwrap();
    put(&mut writer, 1, now + Duration::from_secs(60));
    assert_eq!((metrics.disk_cache.up.get(), metrics.disk_cache.writes.get()), (1, 1));
}

#[test]
fn a_folder_that_becomes_available_is_opened_without_a_write() {
    let parent = Folder::new();
    let folder = Folder(parent.0.join("cache"));
    let (mut writer, metrics) = writer(&folder, 1 << 30);
    writer.retry_interval = Duration::from_millis(10);
    let (commands, receiver) = mpsc::channel(1);
    let thread = std::thread::spawn(move || writer.run(receiver));
    let by = Instant::now() + Duration::from_secs(60);
    let until = |is_so: &dyn Fn() -> bool| {
        while !is_so() {
            assert!(Instant::now() < by, "no further attempt");
            std::thread::sleep(Duration::from_millis(10));
        }
    };
    // The second attempt is one without a write, too.
    until(&|| metrics.disk_cache.io_errors.get() > 1);
    assert_eq!(metrics.disk_cache.up.get(), 0);
    fs::create_dir(&parent.0).unwrap();
    until(&|| metrics.disk_cache.up.get() == 1);
    drop(commands);
    thread.join().unwrap();
}

#[tokio::test]
async fn levels_that_are_fast_to_generate_are_not_cached() {
    let folder = Folder::new();
    let (disk, metrics) = disk(&folder);
    let keys =
        [0, FINEST_LEVEL - 1, FINEST_LEVEL].map(|level| ChunkId::base(ChunkKey::new(level, 1, 1).unwrap()));
    for id in keys {
        disk.write(id, Delivery::Exact, frame(1));
    }
    disk.close().await;
    for id in keys {
        let level = id.key.level();
        assert_eq!(disk.read(id, Delivery::Exact, |_| true).is_some(), level == FINEST_LEVEL);
    }
    assert_eq!((metrics.disk_cache.writes.get(), metrics.disk_cache.misses.get()), (1, 0));
}

#[tokio::test]
async fn an_invalid_frame_is_deleted_and_counted() {
    let folder = Folder::new();
    let (disk, _) = disk(&folder);
    disk.write(id(1), Delivery::Exact, frame(1));
    disk.close().await;
    let (disk, metrics) = self::disk(&folder);
    assert_eq!(disk.read(id(1), Delivery::Exact, |_| false), None);
    assert_eq!((metrics.disk_cache.corrupt.get(), metrics.disk_cache.misses.get()), (1, 1));
    // After the deletion.
    disk.close().await;
    assert!(!folder.path(id(1)).exists());
    assert_eq!(disk.read(id(1), Delivery::Exact, |_| true), None);
    assert_eq!(metrics.disk_cache.corrupt.get(), 1);

    // Longer than any frame: rejected without reading all of it.
    fs::write(folder.path(id(1)), vec![0; 4 * MAX_CHUNK_FRAME]).unwrap();
    let read = disk.read(id(1), Delivery::Exact, |bytes| {
        assert_eq!(bytes.len(), MAX_CHUNK_FRAME + 1);
        chunk_codec::verify(bytes, &WORLD).is_ok()
    });
    assert_eq!((read, metrics.disk_cache.corrupt.get()), (None, 2));
}

#[tokio::test]
async fn a_full_queue_drops_writes_without_blocking() {
    let folder = Folder::new();
    // Nothing executes the commands.
    let (commands, mut receiver) = mpsc::channel(2);
    let metrics = Arc::new(Metrics::default());
    let disk = Disk {
        folder: folder.0.clone(),
        names: FrameNames::new(&WORLD),
        reader: Reader::new(Arc::clone(&metrics)).unwrap(),
        commands,
        metrics: Arc::clone(&metrics),
    };
    for x in 0..5 {
        disk.write(id(x), Delivery::Exact, frame(x));
    }
    assert_eq!(metrics.disk_cache.dropped.get(), 3);
    assert!(receiver.try_recv().is_ok());
    disk.write(id(9), Delivery::Exact, frame(9));
    assert_eq!(metrics.disk_cache.dropped.get(), 3, "the queue has room again");
}

#[test]
fn the_least_recently_used_files_are_evicted_to_the_budget() {
    let folder = Folder::new();
    // Four blocks per shard.
    let budget = 4 * 4096 * names::SHARDS as u64;
    let (mut first, metrics) = writer(&folder, budget);
    let now = Instant::now();
    let day = Duration::from_secs(24 * 3600);
    // Half of the budget, all old; some of them are read again.
    let (old, popular, count) = (512, 16, 4000);
    for x in 0..old {
        put(&mut first, x, now);
        let file = File::options().write(true).open(folder.path(id(x))).unwrap();
        file.set_modified(SystemTime::now() - day).unwrap();
    }
    for x in 0..popular {
        load(&folder.path(id(x))).unwrap();
    }
    for x in old..count {
        put(&mut first, x, now);
    }
    let kept = files(&folder);
    let bytes = 4096 * kept.len() as u64;
    assert!(bytes <= budget && bytes > budget / 2, "{bytes} of {budget}");
    assert_eq!(metrics.disk_cache.evictions.get() + kept.len() as u64, count as u64);
    assert_eq!(metrics.disk_cache.bytes.get(), bytes as i64);
    let left = (popular..old).filter(|x| folder.path(id(*x)).exists()).count();
    assert_eq!(left, 0, "unused files are evicted first");
    drop(first);

    // After a restart with a smaller budget, files are evicted before the first write.
    let (mut second, metrics) = writer(&folder, budget / 2);
    second.try_open(now);
    while second.has_uncounted() {
        second.count_next();
    }
    let kept = files(&folder).len() as u64;
    assert!(kept * 4096 <= budget / 2 && kept > 0);
    assert_eq!(metrics.disk_cache.bytes.get() as u64, kept * 4096);
}

#[test]
fn an_eviction_frees_an_eighth_of_a_share_and_leaves_what_is_no_file() {
    let folder = Folder::new();
    // Eight blocks per shard.
    let (mut writer, metrics) = writer(&folder, 8 * 4096 * names::SHARDS as u64);
    let names = FrameNames::new(&WORLD);
    let of_one_shard = (0..).filter(|x| names::shard_of(&names.path(id(*x), Delivery::Exact)) == 7);
    let frames: Vec<i32> = of_one_shard.take(9).collect();
    let now = Instant::now();
    put(&mut writer, frames[0], now);
    let foreign = folder.path(id(frames[0])).with_file_name("foreign");
    fs::create_dir(&foreign).unwrap();
    for (x, files) in frames[1..].iter().zip([2, 3, 4, 5, 6, 7, 8, 7]) {
        put(&mut writer, *x, now);
        assert_eq!(metrics.disk_cache.bytes.get(), 4096 * files);
    }
    assert_eq!((metrics.disk_cache.evictions.get(), metrics.disk_cache.io_errors.get()), (2, 0));
    assert!(foreign.is_dir());
    assert_eq!(files(&folder).len(), 7 + 1);

    // Nor is it counted after a restart.
    drop(writer);
    let (mut second, metrics) = self::writer(&folder, 1 << 30);
    second.try_open(now);
    while second.has_uncounted() {
        second.count_next();
    }
    assert_eq!((metrics.disk_cache.bytes.get(), metrics.disk_cache.up.get()), (7 * 4096, 1));
}

#[test]
fn a_shard_that_cannot_be_listed_makes_the_folder_unavailable() {
    let folder = Folder::new();
    let (mut writer, metrics) = writer(&folder, 1 << 30);
    writer.try_open(Instant::now());
    // Shards that do not exist yet are empty.
    writer.count_next();
    assert_eq!((metrics.disk_cache.up.get(), metrics.disk_cache.io_errors.get()), (1, 0));
    fs::write(folder.0.join(names::shard_name(1)), "in the way").unwrap();
    writer.count_next();
    assert_eq!((metrics.disk_cache.up.get(), metrics.disk_cache.io_errors.get()), (0, 1));
}

/// Lines of the log.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Log {
    fn lines(&self) -> Vec<String> {
        String::from_utf8_lossy(&self.0.lock().unwrap()).lines().map(String::from).collect()
    }
}

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn an_outage_is_logged_once_with_its_cause_and_its_end() {
    // The second cause is a text of the system.
    for (is_in_the_way, cause) in [(false, "its parent folder does not exist"), (true, "exists")] {
        let parent = Folder::new();
        let folder = Folder(parent.0.join("cache"));
        if is_in_the_way {
            fs::create_dir(&parent.0).unwrap();
            fs::write(&folder.0, "in the way").unwrap();
        }
        let log = Log::default();
        let copy = log.clone();
        let lines = tracing_subscriber::fmt().with_writer(move || copy.clone()).with_ansi(false);
        tracing::subscriber::with_default(lines.finish(), || {
            let (mut writer, _) = writer(&folder, 1 << 30);
            let now = Instant::now();
            for minute in 0..3 {
                put(&mut writer, 1, now + Duration::from_secs(60 * minute));
                assert_eq!(log.lines().len(), 1, "{:?}", log.lines());
            }
            let line = &log.lines()[0];
            assert!(line.contains("WARN") && line.contains(cause), "{line}");
            if is_in_the_way {
                fs::remove_file(&folder.0).unwrap();
            } else {
                fs::create_dir(&parent.0).unwrap();
            }
            put(&mut writer, 1, now + Duration::from_secs(180));
            assert!(log.lines()[1].contains("available again"), "{:?}", log.lines());
            assert_eq!(log.lines().len(), 2);
        });
    }
}

#[test]
fn a_replaced_file_is_counted_once() {
    let folder = Folder::new();
    let now = Instant::now();
    let (mut first, _) = writer(&folder, 1 << 30);
    for x in 0..60 {
        put(&mut first, x, now);
    }
    drop(first);
    for x in 0..60 {
        fs::write(folder.path(id(x)), "damaged").unwrap();
    }
    let (mut second, metrics) = writer(&folder, 1 << 30);
    second.try_open(now);
    while second.has_uncounted() {
        second.count_next();
    }
    let there = || 4096 * files(&folder).len() as i64;
    assert_eq!((metrics.disk_cache.bytes.get(), there()), (60 * 4096, 60 * 4096));
    for x in 0..60 {
        // Found by a reader, or not.
        if x % 2 == 0 {
            second.discard(&FrameNames::new(&WORLD).path(id(x), Delivery::Exact));
        }
        assert_eq!(metrics.disk_cache.bytes.get(), there());
        put(&mut second, x, now);
        assert_eq!(metrics.disk_cache.bytes.get(), there());
    }
    assert_eq!(metrics.disk_cache.bytes.get(), 60 * 4096);
}

#[test]
fn a_read_updates_the_file_time_once_per_interval() {
    let folder = Folder::new();
    let (mut writer, _) = writer(&folder, 1 << 30);
    put(&mut writer, 1, Instant::now());
    let path = folder.path(id(1));
    let file = File::options().write(true).open(&path).unwrap();
    let age = |then: SystemTime| SystemTime::now().duration_since(then).unwrap();
    for (old, is_updated) in [(TOUCH_INTERVAL * 2, true), (TOUCH_INTERVAL / 2, false)] {
        file.set_modified(SystemTime::now() - old).unwrap();
        load(&path).unwrap();
        let seen = age(fs::metadata(&path).unwrap().modified().unwrap());
        assert_eq!(seen < TOUCH_INTERVAL / 4, is_updated, "{seen:?}");
    }
}

#[test]
fn an_unavailable_folder_is_retried_after_a_minute() {
    let folder = Folder::new();
    let now = Instant::now();
    let (mut writer, metrics) = writer(&folder, 1 << 30);
    // A file in the place of the folder, which no user can write to.
    fs::write(&folder.0, "in the way").unwrap();
    put(&mut writer, 1, now);
    assert_eq!((metrics.disk_cache.io_errors.get(), metrics.disk_cache.dropped.get()), (1, 1));
    fs::remove_file(&folder.0).unwrap();
    put(&mut writer, 2, now + Duration::from_secs(59));
    assert_eq!(
        (metrics.disk_cache.io_errors.get(), metrics.disk_cache.dropped.get()),
        (1, 2),
        "not retried before the interval"
    );
    put(&mut writer, 3, now + Duration::from_secs(61));
    assert_eq!((metrics.disk_cache.writes.get(), metrics.disk_cache.up.get()), (1, 1));
    assert!(folder.path(id(3)).exists() && !folder.path(id(1)).exists());
}

#[cfg(unix)]
#[test]
fn a_read_only_folder_is_read_and_not_written() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    let now = Instant::now();
    let (mut first, _) = writer(&folder, 1 << 30);
    put(&mut first, 1, now);
    drop(first);
    fs::set_permissions(&folder.0, fs::Permissions::from_mode(0o555)).unwrap();
    // A superuser may write regardless of the permissions.
    let is_bound = fs::write(folder.0.join("probe"), "").is_err();
    let (mut second, metrics) = writer(&folder, 1 << 30);
    put(&mut second, 2, now);
    assert_eq!(folder.path(id(2)).exists(), !is_bound);
    assert_eq!(metrics.disk_cache.up.get(), i64::from(!is_bound));
    assert_eq!(load(&folder.path(id(1))).unwrap(), frame(1));
    fs::set_permissions(&folder.0, fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn a_removed_folder_is_not_created_again_and_is_reused() {
    let folder = Folder::new();
    let now = Instant::now();
    let (mut writer, metrics) = writer(&folder, 1 << 30);
    put(&mut writer, 1, now);
    assert_eq!((metrics.disk_cache.writes.get(), metrics.disk_cache.bytes.get()), (1, 4096));
    fs::remove_dir_all(&folder.0).unwrap();
    put(&mut writer, 2, now);
    put(&mut writer, 3, now + Duration::from_secs(61));
    assert!(!folder.0.exists(), "the disk under a lost mount must not be filled");
    assert_eq!(
        (metrics.disk_cache.io_errors.get(), metrics.disk_cache.dropped.get(), metrics.disk_cache.up.get()),
        (2, 2, 0)
    );
    fs::create_dir(&folder.0).unwrap();
    put(&mut writer, 4, now + Duration::from_secs(122));
    assert_eq!((metrics.disk_cache.up.get(), metrics.disk_cache.bytes.get()), (1, 4096));
    assert!(folder.path(id(4)).exists());
}

#[test]
fn a_folder_is_locked_by_one_server() {
    let folder = Folder::new();
    let now = Instant::now();
    let (mut first, _) = writer(&folder, 1 << 30);
    let (mut second, metrics) = writer(&folder, 1 << 30);
    put(&mut first, 1, now);
    put(&mut second, 2, now);
    assert_eq!((metrics.disk_cache.io_errors.get(), metrics.disk_cache.dropped.get()), (1, 1));
    drop(first);
    put(&mut second, 2, now + Duration::from_secs(61));
    assert_eq!((metrics.disk_cache.writes.get(), metrics.disk_cache.up.get()), (1, 1));
}

#[test]
fn a_partial_write_of_a_crash_is_overwritten() {
    let folder = Folder::new();
    let (mut writer, _) = writer(&folder, 1 << 30);
    fs::create_dir(&folder.0).unwrap();
    fs::write(folder.0.join("unfinished"), vec![1; 100_000]).unwrap();
    put(&mut writer, 1, Instant::now());
    assert_eq!(load(&folder.path(id(1))).unwrap(), frame(1));
    let names: Vec<_> = fs::read_dir(&folder.0).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(!names.iter().any(|name| name == "unfinished"), "{names:?}");
}

#[cfg(unix)]
#[test]
fn an_entry_that_is_no_file_affects_no_other_frame() {
    let folder = Folder::new();
    let (disk, metrics) = disk(&folder);
    // The writer thread creates the folder, and takes one that appears meanwhile for an error.
    while metrics.disk_cache.up.get() == 0 {
        std::thread::yield_now();
    }
    let path_of = |x| {
        let path = folder.path(id(x));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        path
    };
    let outside = folder.0.join("outside");
    let (pipe, link, empty, full) = (path_of(1), path_of(2), path_of(3), path_of(4));
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    fs::write(&outside, frame(2)).unwrap();
    File::options().write(true).open(&outside).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
    std::os::unix::fs::symlink(&outside, &link).unwrap();
    fs::create_dir(&empty).unwrap();
    fs::create_dir_all(full.join("something")).unwrap();
    for x in 1..=4 {
        assert_eq!(disk.read(id(x), Delivery::Exact, |bytes| bytes == frame(x)), None);
    }
    assert_eq!((metrics.disk_cache.corrupt.get(), metrics.disk_cache.timeouts.get()), (4, 0));
    // The writer thread deletes them.
    while [&pipe, &link, &empty].iter().any(|path| fs::symlink_metadata(path).is_ok()) {
        std::thread::yield_now();
    }
    assert_eq!(
        [&pipe, &link, &empty, &full].map(|path| fs::symlink_metadata(path).is_ok()),
        [false, false, false, true]
    );
    assert_eq!(
        fs::metadata(&outside).unwrap().modified().unwrap(),
        SystemTime::UNIX_EPOCH,
        "outside the folder"
    );

    // All but the last can be written again.
    for x in [4, 1, 2, 3] {
        disk.write(id(x), Delivery::Exact, frame(x));
    }
    while metrics.disk_cache.writes.get() + metrics.disk_cache.dropped.get() < 4 {
        std::thread::yield_now();
    }
    assert_eq!((metrics.disk_cache.writes.get(), metrics.disk_cache.up.get()), (3, 1));
    for x in 1..=3 {
        assert_eq!(disk.read(id(x), Delivery::Exact, |bytes| bytes == frame(x)), Some(frame(x)));
    }
}
