//! The shared store: exact frames in an object store that all replicas read and write.
//!
//! A chunk is read before it is made, where that may save time, and written after. An object is
//! named by what its content follows from, so replicas need no agreement: a second write changes
//! nothing, a lost object is made again. Every object that is read is checked by digest and key
//! before it is used; who can write to the store is trusted beyond that.
//!
//! A generation thread waits for the store at most as long as chunks of that level took to make
//! lately, and sends a request only if the store answers, and sooner than that; reads that bring
//! nothing may take an eighth of the time of making, and what would not be read is not written
//! ([`pace`]). A [`breaker`] stops writes to a store that fails. Chunks of baked [`region`]s lie in
//! [`pack`]s, others in objects of their own.

pub mod address;
pub mod breaker;
mod folder;
pub mod pace;
pub mod pack;
pub mod region;
pub mod tile;
mod writer;

pub use address::StoreAddress;

use crate::chunk_id::ChunkId;
use crate::metrics::Metrics;
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::path::Path;
use object_store::{Error, GetOptions, ObjectStore, ObjectStoreExt};
use pace::Pace;
use pack::{PackError, PackIndex};
use protocol::chunk_codec;
use protocol::limits::MAX_CHUNK_FRAME;
use quick_cache::sync::Cache;
use region::BakedRegion;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, TrySendError, sync_channel};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};
use terrain::{Chunk, ChunkKey, WorldDigest};
use tile::{ObjectNames, PackTile};
use tokio::runtime::Runtime;
use tokio::sync::Semaphore;
use tokio::time::timeout;
use writer::Writer;

/// The finest level that is stored, unless a region has a finer one: as for the disk cache.
pub const FINEST_LEVEL: u8 = crate::cache::disk::FINEST_LEVEL;

/// Timeout of one read, unless chunks may wait longer. Its thread no longer waits then; the answer
/// only counts for the pace.
const READ_TIMEOUT: Duration = Duration::from_secs(2);

/// Reads in flight. One more is not sent: the chunk is made. A timeout ends a request over HTTP.
/// Calls of the system go on after it; [`folder`] bounds them.
const READS_IN_FLIGHT: usize = 64;

/// Indexes of packs in memory, 1 KiB each.
const INDEXES: usize = 4096;

/// Time between two scans for regions that were baked meanwhile.
const SCAN_INTERVAL: Duration = Duration::from_secs(60);

/// Time between two scans while they fail.
const SCAN_RETRY_INTERVAL: Duration = Duration::from_secs(5);

/// Longest time that a server waits for its first scan before it takes clients: chunks of regions
/// that it does not know of are made.
const FIRST_SCAN_TIMEOUT: Duration = Duration::from_secs(3);

/// Time for one scan: a list, and some objects at once.
const REGIONS_TIMEOUT: Duration = Duration::from_secs(30);

/// Objects of regions that are read at once.
const REGION_READS: usize = 16;

/// Regions that are used; further ones are ignored with a warning.
const MAX_REGIONS: usize = 1024;

/// Longest object of a region, bytes.
const MAX_REGION: u64 = 4096;

/// Options of the store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoreConfig {
    /// Where it is.
    pub address: StoreAddress,
    /// Least time that a chunk waits for the store before it is made.
    pub wait: Duration,
}

/// The store of one world.
#[derive(Debug)]
pub struct Store {
    inner: Arc<Inner>,
    writer: Writer,
    /// Of its own: neither peers nor generation delay the store, nor it them. Taken by the drop.
    runtime: Option<Runtime>,
}

#[derive(Debug)]
struct Inner {
    objects: Arc<dyn ObjectStore>,
    names: ObjectNames,
    world: WorldDigest,
    regions: RwLock<Vec<BakedRegion>>,
    indexes: Cache<PackTile, Arc<PackIndex>>,
    /// Tiles whose pack is damaged or lost: their chunks are objects of their own. A scan for
    /// regions forgets them, since a pack may have been baked again.
    broken: Cache<PackTile, ()>,
    reads: Arc<Semaphore>,
    read_timeout: Duration,
    pace: Pace,
    /// The store has refused a read, and a warning was logged.
    is_refused: AtomicBool,
    /// The last scan for regions failed, and a warning was logged.
    is_unlisted: AtomicBool,
    /// The first scan for regions has ended.
    has_scanned: AtomicBool,
    /// End of the wait for it.
    ready_by: Instant,
    metrics: Arc<Metrics>,
}

/// The result of a read.
enum Fetched {
    Object(Bytes),
    /// The index of the pack is damaged.
    Invalid,
    Missing,
    Failed,
}

impl Store {
    /// Opens a store. Nothing is awaited: a store that is not there is one without objects.
    ///
    /// # Errors
    /// Invalid settings, or the system cannot start its thread.
    pub fn new(config: &StoreConfig, world: &WorldDigest, metrics: Arc<Metrics>) -> io::Result<Self> {
        let (objects, root) = config.address.open().map_err(io::Error::other)?;
        Self::over(objects, &root, config.wait, world, metrics)
    }

    /// A store over any objects.
    ///
    /// # Errors
    /// The system cannot start its thread.
    pub fn over(
        objects: Arc<dyn ObjectStore>,
        root: &Path,
        wait: Duration,
        world: &WorldDigest,
        metrics: Arc<Metrics>,
    ) -> io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("store")
            .enable_all()
            .build()?;
        let writer = Writer::start(runtime.handle(), Arc::clone(&objects), Arc::clone(&metrics));
        metrics.store.up.set(1);
        let inner = Arc::new(Inner {
            objects,
            names: ObjectNames::new(root, world),
            world: *world,
            regions: RwLock::default(),
            indexes: Cache::new(INDEXES),
            broken: Cache::new(INDEXES),
            reads: Arc::new(Semaphore::new(READS_IN_FLIGHT)),
            read_timeout: READ_TIMEOUT.max(wait),
            pace: Pace::new(wait),
            is_refused: AtomicBool::new(false),
            is_unlisted: AtomicBool::new(false),
            has_scanned: AtomicBool::new(false),
            ready_by: Instant::now() + FIRST_SCAN_TIMEOUT,
            metrics,
        });
        runtime.spawn(Arc::clone(&inner).follow_regions());
        Ok(Self { inner, writer, runtime: Some(runtime) })
    }

    /// A chunk with its exact frame, if the store has it and answers in time. Blocks: not
    /// for async threads.
    #[must_use]
    pub fn read(&self, id: ChunkId) -> Option<(Chunk, Bytes)> {
        let inner = &self.inner;
        let key = id.key;
        let tile = inner.whole_pack(id);
        // Without a pack no server writes these.
        if tile.is_none() && key.level() < FINEST_LEVEL {
            return None;
        }
        let permit = Arc::clone(&inner.reads).try_acquire_owned().ok();
        let is_stored = tile.is_some();
        let admitted =
            permit.and_then(|permit| Some((inner.pace.wait(key, is_stored, Instant::now())?, permit)));
        let Some((wait, permit)) = admitted else {
            inner.metrics.store.reads_skipped.inc();
            return None;
        };
        // For one answer; after the timeout it is dropped.
        let (sender, answer) = sync_channel(1);
        let reading = Arc::clone(inner);
        self.runtime.as_ref()?.spawn(async move {
            let read = reading.fetch(id, tile).await;
            drop(permit);
            if let Err(TrySendError::Disconnected(Fetched::Invalid)) = sender.try_send(read) {
                // Late, and the next reads of the tile do not find it.
                reading.metrics.store.reads_invalid.inc();
            }
        });
        let started = Instant::now();
        // The receiver ends with its timeout.
        let answer = { answer }.recv_timeout(wait);
        if matches!(answer, Ok(Fetched::Object(_) | Fetched::Invalid | Fetched::Missing)) {
            inner.pace.in_time();
        }
        let found = match answer {
            Ok(Fetched::Object(frame)) => inner.checked(key, tile, &frame),
            Ok(Fetched::Invalid) => {
                inner.metrics.store.reads_invalid.inc();
                None
            }
            Ok(Fetched::Missing) => {
                inner.metrics.store.misses.inc();
                inner.pace.missing();
                None
            }
            Ok(Fetched::Failed) | Err(RecvTimeoutError::Disconnected) => {
                inner.metrics.store.reads_failed.inc();
                None
            }
            Err(RecvTimeoutError::Timeout) => {
                inner.pace.late(wait, Instant::now());
                inner.metrics.store.reads_late.inc();
                None
            }
        };
        if found.is_none() {
            inner.pace.useless(started.elapsed());
        } else if inner.pace.useful(key) {
            tracing::info!("objects of the store are valid again");
        }
        found
    }

    /// A chunk was made in this time because the store did not have it. Reads may take a part of
    /// that, unless the chunk would not have been read anyway.
    pub fn made(&self, id: ChunkId, took: Duration) {
        if id.key.level() >= FINEST_LEVEL || self.inner.whole_pack(id).is_some() {
            self.inner.pace.made(id.key, took);
        }
    }

    /// Writes the exact frame of a chunk that was made, if its level is stored, no whole pack has
    /// it, and it would be read. The frame is not asked for if it is not written.
    pub fn write(&self, id: ChunkId, frame: impl FnOnce() -> Bytes) {
        if id.key.level() < FINEST_LEVEL || self.inner.whole_pack(id).is_some() {
            return;
        }
        if self.inner.pace.is_worth_writing(id.key) {
            self.writer.write(self.inner.names.chunk(id), frame);
        } else {
            self.inner.metrics.store.writes_skipped.inc();
        }
    }

    /// Whether the regions were scanned once, or the wait for that has ended.
    #[must_use]
    pub fn is_ready(&self, now: Instant) -> bool {
        self.inner.has_scanned.load(Ordering::Relaxed) || now >= self.inner.ready_by
    }

    /// Waits a bounded time for the pending writes.
    pub async fn close(&self) {
        self.writer.close().await;
    }

    /// Waits for one scan of the regions: for tests.
    #[cfg(test)]
    pub fn scan_regions(&self) {
        let (sender, seen) = sync_channel(1);
        let inner = Arc::clone(&self.inner);
        self.runtime.as_ref().expect("not dropped").spawn(async move {
            inner.scan_regions().await;
            let _ = sender.send(());
        });
        seen.recv().expect("the task ends");
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // A runtime must not be waited for on an async thread.
            runtime.shutdown_background();
        }
    }
}

impl Inner {
    /// The tile of a chunk, if a region has its pack. Packs have the land that the seed makes.
    fn packed(&self, id: ChunkId) -> Option<PackTile> {
        let tile = id.edition.is_base().then(|| PackTile::of(id.key).0)?;
        let regions = self.regions.read().unwrap_or_else(PoisonError::into_inner);
        regions.iter().any(|region| region.contains(tile)).then_some(tile)
    }

    /// The same unless the pack is damaged or lost, as far as is known.
    fn whole_pack(&self, id: ChunkId) -> Option<PackTile> {
        self.packed(id).filter(|tile| self.broken.get(tile).is_none())
    }

    /// The chunk of a frame that was read, if the frame is that of the key and undamaged.
    fn checked(&self, key: ChunkKey, tile: Option<PackTile>, frame: &[u8]) -> Option<(Chunk, Bytes)> {
        let chunk = chunk_codec::decode(frame, &self.world).ok().filter(|chunk| chunk.key == key);
        let Some(chunk) = chunk else {
            self.metrics.store.reads_invalid.inc();
            tile.inspect(|tile| self.is_broken(*tile));
            tracing::debug!(%key, "an object of the store is damaged or foreign; the chunk is made");
            if self.pace.invalid(Instant::now()) {
                tracing::warn!(
                    "objects of the store are damaged or foreign; chunks are made, and one read in 5 s tries \
                     it again"
                );
            }
            return None;
        };
        self.metrics.store.hits.inc();
        // Bytes that came over HTTP are a part of the connection's buffer of 8 KiB and more. A
        // cache counts the length of the frame only.
        Some((chunk, Bytes::copy_from_slice(frame)))
    }

    /// Notes that a tile has no whole pack. It may have been replaced since its index was read.
    fn is_broken(&self, tile: PackTile) {
        self.indexes.remove(&tile);
        self.broken.insert(tile, ());
    }

    /// The bytes of a chunk's object. Reports to the pace, late answers too.
    async fn fetch(&self, id: ChunkId, tile: Option<PackTile>) -> Fetched {
        let started = Instant::now();
        let read = timeout(self.read_timeout, self.get(id, tile)).await;
        let took = started.elapsed();
        self.metrics.store.read_seconds.observe(took.as_secs_f64());
        let why = match read {
            Ok(Ok(found)) => {
                if self.pace.answered(took) {
                    tracing::info!("the store answers again");
                    self.metrics.store.up.set(1);
                }
                return found;
            }
            Ok(Err(error)) => one_line(&error),
            Err(_) => format!("no answer within {} ms", self.read_timeout.as_millis()),
        };
        tracing::debug!(why, "a read from the store failed");
        if self.pace.failed(Instant::now()) {
            tracing::warn!(why, "the store fails; chunks are made, and one read in 5 s tries it again");
            self.metrics.store.up.set(0);
        }
        Fetched::Failed
    }

    async fn get(&self, id: ChunkId, tile: Option<PackTile>) -> object_store::Result<Fetched> {
        if let Some(tile) = tile.filter(|tile| self.broken.get(tile).is_none()) {
            let index = self.index(tile).await?;
            if !matches!(index, Some(Ok(_))) {
                self.is_broken(tile);
            }
            let Ok(index) = index.transpose() else { return Ok(Fetched::Invalid) };
            if let Some(range) = index.and_then(|index| index.frame(PackTile::of(id.key).1)) {
                let frame = self.objects.get_range(&self.names.pack(tile), range).await;
                if frame.is_err() {
                    // A shorter pack may have replaced that of the index.
                    self.indexes.remove(&tile);
                }
                return Ok(self.found(frame)?.map_or(Fetched::Missing, Fetched::Object));
            }
        }
        if id.key.level() < FINEST_LEVEL {
            return Ok(Fetched::Missing);
        }
        let answer = self.objects.get_opts(&self.names.chunk(id), GetOptions::default()).await;
        let Some(answer) = self.found(answer)? else { return Ok(Fetched::Missing) };
        if answer.meta.size > MAX_CHUNK_FRAME as u64 {
            // No frame: its bytes are invalid, however many come.
            return Ok(Fetched::Object(Bytes::new()));
        }
        answer.bytes().await.map(Fetched::Object)
    }

    /// The index of a tile's pack, from memory or the store; none if there is no pack.
    async fn index(&self, tile: PackTile) -> object_store::Result<Option<Result<Arc<PackIndex>, PackError>>> {
        if let Some(index) = self.indexes.get(&tile) {
            return Ok(Some(Ok(index)));
        }
        let range = GetOptions::new().with_range(Some(0..pack::HEADER as u64));
        let Some(header) = self.found(self.objects.get_opts(&self.names.pack(tile), range).await)? else {
            return Ok(None);
        };
        let length = header.meta.size;
        let index = match pack::index(tile, &header.bytes().await?) {
            // A cut pack would fail range by range, as if the store did.
            Ok(index) if index.end() != length => Err(PackError::Index),
            index => index.map(Arc::new),
        };
        if let Ok(index) = &index {
            self.indexes.insert(tile, Arc::clone(index));
        }
        Ok(Some(index))
    }

    /// An object that does not exist is no error. Nor is one that may not be read: this is how S3
    /// answers for an absent object to a client that may not list the bucket, and such answers
    /// would stop all reads.
    fn found<T>(&self, result: object_store::Result<T>) -> object_store::Result<Option<T>> {
        match result {
            Ok(found) => Ok(Some(found)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error @ Error::PermissionDenied { .. }) => {
                if !self.is_refused.swap(true, Ordering::Relaxed) {
                    tracing::warn!(
                        why = one_line(&error),
                        "the store refuses reads, which count as misses; give the rights to get and list"
                    );
                }
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Scans the regions periodically, for ever.
    async fn follow_regions(self: Arc<Self>) {
        loop {
            let has_succeeded = self.scan_regions().await;
            self.has_scanned.store(true, Ordering::Relaxed);
            tokio::time::sleep(if has_succeeded { SCAN_INTERVAL } else { SCAN_RETRY_INTERVAL }).await;
        }
    }

    /// Whether the scan succeeded.
    async fn scan_regions(&self) -> bool {
        let why = match timeout(REGIONS_TIMEOUT, self.list_regions()).await {
            Ok(Ok(regions)) => {
                self.has_regions(regions);
                return true;
            }
            Ok(Err(error)) => one_line(&error),
            Err(_) => format!("no answer within {} s", REGIONS_TIMEOUT.as_secs()),
        };
        if self.is_unlisted.swap(true, Ordering::Relaxed) {
            tracing::debug!(why, "cannot list the regions of the store");
        } else {
            tracing::warn!(
                why,
                "cannot list the regions of the store: baked chunks are made; give the right to list"
            );
        }
        false
    }

    /// The regions that a scan has found.
    fn has_regions(&self, regions: Vec<BakedRegion>) {
        self.is_unlisted.store(false, Ordering::Relaxed);
        self.broken.clear();
        let mut known = self.regions.write().unwrap_or_else(PoisonError::into_inner);
        if *known != regions {
            tracing::info!(regions = regions.len(), "regions of the store");
            *known = regions;
        }
    }

    async fn list_regions(&self) -> object_store::Result<Vec<BakedRegion>> {
        let mut objects = self.objects.list(Some(&self.names.regions()));
        let mut names = Vec::new();
        while let Some(object) = objects.try_next().await? {
            if names.len() == MAX_REGIONS {
                tracing::warn!("the store has over {MAX_REGIONS} regions; the others are ignored");
                break;
            }
            if object.size <= MAX_REGION {
                names.push(object.location);
            }
        }
        let read = |name| async { self.region(name).await };
        let regions: Vec<_> = stream::iter(names).map(read).buffered(REGION_READS).try_collect().await?;
        Ok(regions.into_iter().flatten().collect())
    }

    /// The region of an object; none if the object is no region or has the name of another.
    async fn region(&self, name: Path) -> object_store::Result<Option<BakedRegion>> {
        let Some(object) = self.found(self.objects.get(&name).await)? else { return Ok(None) };
        let region: Option<BakedRegion> = serde_json::from_slice(&object.bytes().await?).ok();
        let region = region.filter(|region| {
            let checked = BakedRegion::new(&(region.finest..=region.coarsest), region.area_m);
            checked.is_ok_and(|region| name.filename() == Some(&region.name()))
        });
        if region.is_none() {
            tracing::warn!(object = %name, "no region; ignored");
        }
        Ok(region)
    }
}

/// An error of a store, which may be a page of XML, as the start of one line.
fn one_line(error: &Error) -> String {
    const SHOWN: usize = 300;
    let text = error.to_string();
    text.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(SHOWN).collect()
}

#[cfg(test)]
pub(crate) mod test_store;
#[cfg(test)]
mod tests;
