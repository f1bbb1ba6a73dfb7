//! Scheduling, rendering and caching of map tiles.
//!
//! Map tiles use a bounded share of the generation pool: all tiles together are one flow per four
//! threads. Waiting tiles are counted and bounded; finished ones are cached by bytes.

use crate::generation::{Flow, Generation, GenerationError};
use crate::limits::per_ip::PerIpLimiter;
use crate::limits::rate_limit::TokenBucket;
use crate::limits::site_turns::SiteTurns;
use crate::map::elevation::{self, ElevationGrid, TILE_PIXELS};
use crate::map::hillshade;
use crate::metrics::Metrics;
use bytes::Bytes;
use protocol::server::ChunkRequest;
use protocol::{Delivery, chunk_codec};
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;
use terrain::{Chunk, ChunkKey, WorldDigest};
use thiserror::Error;
use tokio::sync::Semaphore;
use tokio::time::{Instant, timeout_at};

/// Version of colours and shading. Part of the tiles' URLs, since tiles are immutable.
pub const STYLE: u32 = 1;

/// Tiles that may wait or be rendered: about three browser windows. One more is rejected.
const MAX_WAITING: usize = 96;

/// Longest wait for a turn. The client has moved on by then.
const MAX_WAIT: Duration = Duration::from_secs(10);

/// Chunks of one tile in generation at once. With all at once, the last would wait for the first
/// and exceed a short deadline.
const JOB_WINDOW: usize = 8;

/// Bytes per entry in addition to the image: key, digest, handle and the map's share.
const TILE_OVERHEAD: u64 = 160;

/// Why a tile is not available.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MapError {
    /// Too many tiles are waiting, or this one waited for too long.
    #[error("too many map tiles are requested at once, retry later")]
    Busy,
    /// The client has no tokens left, and gets none within the deadline.
    #[error("the rate limit of this address is exceeded, retry later")]
    OverRate,
    /// One of its chunks is not available.
    #[error(transparent)]
    Generation(#[from] GenerationError),
}

/// A finished tile.
#[derive(Clone, Debug)]
pub struct Tile {
    /// The image: PNG, RGB, [`TILE_PIXELS`] per side.
    pub png: Bytes,
    /// Digest of the image's bytes.
    pub digest: [u8; 16],
}

/// Whose tile it is: its chunks are requested for the client and charged to the bucket.
#[derive(Clone, Copy)]
pub struct Requester<'a> {
    /// Address of the client, if known.
    pub client: Option<IpAddr>,
    /// What generates the chunks.
    pub generation: &'a Generation,
    /// The client's budget.
    pub bucket: &'a TokenBucket,
}

/// Renders and caches tiles.
pub struct Map {
    world: WorldDigest,
    cache: Cache<ChunkKey, Tile, TileWeight>,
    /// A turn per tile being rendered, held to the end even if the request is cancelled: clients
    /// that cancel must not get more tiles rendered at once than others.
    turns: SiteTurns,
    /// One permit per tile that waits or is rendered.
    queue_permits: Semaphore,
    /// The places of a client network: no more than remain free.
    places: PerIpLimiter,
    metrics: Arc<Metrics>,
}

#[derive(Clone)]
struct TileWeight;

impl Weighter<ChunkKey, Tile> for TileWeight {
    fn weight(&self, _key: &ChunkKey, tile: &Tile) -> u64 {
        tile.png.len() as u64 + TILE_OVERHEAD
    }
}

impl Map {
    /// A map with a cache of `cache_bytes`; `threads` is the number of generation threads.
    #[must_use]
    pub fn new(world: WorldDigest, cache_bytes: u64, threads: usize, metrics: Arc<Metrics>) -> Self {
        // About 64 KiB per tile; the estimate only sizes the first tables.
        let cache = Cache::with_weighter((cache_bytes >> 16) as usize, cache_bytes, TileWeight);
        Self {
            world,
            cache,
            turns: SiteTurns::new(threads.div_ceil(4)),
            queue_permits: Semaphore::new(MAX_WAITING),
            places: PerIpLimiter::fair_share(MAX_WAITING),
            metrics,
        }
    }

    /// Drops all cached tiles.
    pub fn clear_cache(&self) {
        self.cache.clear();
    }

    /// The tile of a key for a client; rendering and sending are charged to its bucket. Dropping
    /// the future cancels its requests.
    ///
    /// # Errors
    /// See [`MapError`].
    pub async fn tile(&self, key: ChunkKey, requester: Requester<'_>) -> Result<Tile, MapError> {
        let tile = self.cached_or_rendered(key, requester).await;
        match &tile {
            Ok(tile) => requester.bucket.charge_bytes(tile.png.len(), Instant::now()),
            Err(_) => drop(self.metrics.http.tiles_failed.inc()),
        }
        tile
    }

    async fn cached_or_rendered(&self, key: ChunkKey, requester: Requester<'_>) -> Result<Tile, MapError> {
        let Requester { client, generation, bucket } = requester;
        if let Some(tile) = self.cache.get(&key) {
            self.metrics.http.tile_cache_hits.inc();
            return Ok(tile);
        }
        let queue = || {
            let permit = self.queue_permits.try_acquire().map_err(|_| MapError::Busy)?;
            let free = self.queue_permits.available_permits();
            let place = self.places.try_acquire(client, free).ok_or(MapError::Busy)?;
            Ok::<_, MapError>((permit, place))
        };
        let mut place = Some(queue()?);
        let sources = elevation::sources(key);
        let mut frames = vec![None; sources.len()];
        // When its turn must have come, and when it must have the tokens that it waits for.
        let by = Instant::now() + MAX_WAIT;
        let mut tokens_by = None;
        let turn = loop {
            let Ok(Some(turn)) = timeout_at(by, self.turns.acquire(client)).await else {
                return Err(MapError::Busy);
            };
            // Another request may have rendered this tile meanwhile.
            if let Some(tile) = self.cache.get(&key) {
                self.metrics.http.tile_cache_hits.inc();
                return Ok(tile);
            }
            if fetch_frames(&sources, &mut frames, requester).await? {
                break turn;
            }
            // While it waits for tokens, others have its turn and its place in the queue.
            drop((turn, place.take()));
            let tokens_by = *tokens_by.get_or_insert_with(|| by.min(Instant::now() + generation.deadline()));
            if !bucket.wait(tokens_by, &self.metrics).await {
                return Err(MapError::OverRate);
            }
            place = Some(queue()?);
        };
        let frames: Vec<Bytes> = frames.into_iter().flatten().collect();
        let (world, bucket) = (self.world, bucket.clone());
        // Milliseconds of computing: not for async threads.
        let rendered = tokio::task::spawn_blocking(move || {
            let started = Instant::now();
            let tile = render_tile(key, &frames, &world);
            let now = Instant::now();
            bucket.charge_work((now - started).as_micros() as i64, now);
            drop(turn);
            tile
        })
        .await;
        let Ok(Some(tile)) = rendered else { return Err(GenerationError::Failed.into()) };
        self.metrics.http.tiles_rendered.inc();
        self.cache.insert(key, tile.clone());
        Ok(tile)
    }
}

/// Fetches the exact frames of chunks that are missing, in the order of the keys, and requests none
/// while the bucket is empty. Returns whether all are there.
async fn fetch_frames(
    keys: &[ChunkKey],
    frames: &mut [Option<Bytes>],
    requester: Requester<'_>,
) -> Result<bool, GenerationError> {
    let Requester { client, generation, bucket } = requester;
    for (key, frame) in keys.iter().zip(&mut *frames).filter(|(_, frame)| frame.is_none()) {
        *frame = generation.cached(*key, Delivery::Exact);
    }
    let missing: Vec<usize> = (0..keys.len()).filter(|index| frames[*index].is_none()).collect();
    let (mut flow, mut remaining): (Flow, _) =
        (generation.download(client, bucket.clone()), missing.into_iter());
    loop {
        while flow.in_flight() < JOB_WINDOW && bucket.delay(Instant::now()).is_none() {
            let Some(index) = remaining.next() else { break };
            // The request number is the index of the frame.
            let chunk = ChunkRequest { key: keys[index], request: Some(index as u32), priority: u64::MAX };
            flow.request(chunk, Delivery::Exact);
        }
        if flow.in_flight() == 0 {
            break;
        }
        for (chunk, result) in flow.completions().await {
            if let Some(frame) = chunk.request.and_then(|index| frames.get_mut(index as usize)) {
                *frame = Some(result?);
            }
        }
    }
    Ok(frames.iter().all(Option::is_some))
}

/// Renders a tile; none if a frame is invalid, which would be a bug of this server.
fn render_tile(key: ChunkKey, frames: &[Bytes], world: &WorldDigest) -> Option<Tile> {
    let chunks: Option<Vec<Chunk>> =
        frames.iter().map(|frame| chunk_codec::decode(frame, world).ok()).collect();
    let pixels = hillshade::render(&ElevationGrid::new(key, &chunks?), key.level());
    let png = encode(&pixels).ok()?;
    let mut digest = [0; 16];
    digest.copy_from_slice(&blake3::hash(&png).as_bytes()[..16]);
    Some(Tile { png: png.into(), digest })
}

/// RGB pixels as PNG.
fn encode(pixels: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::with_capacity(pixels.len() / 2);
    let side = TILE_PIXELS as u32;
    let mut encoder = png::Encoder::new(&mut bytes, side, side);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chunk_id::ChunkId;
    use crate::generation::Limits;
    use crate::limits::rate_limit::RateLimiter;
    use crate::source::{ChunkSource, ProceduralSource};
    use terrain::{Chunk, Land};

    /// A source that takes at least a time for each chunk.
    struct Slow(ProceduralSource, Duration);

    impl ChunkSource for Slow {
        fn world(&self) -> WorldDigest {
            self.0.world()
        }

        fn chunk(&self, id: ChunkId, known_error: Option<u32>) -> Chunk {
            std::thread::sleep(self.1);
            self.0.chunk(id, known_error)
        }
    }

    fn service(metrics: &Arc<Metrics>, jobs: usize) -> (Land, Generation) {
        slow_service(metrics, jobs, Duration::ZERO)
    }

    fn slow_service(metrics: &Arc<Metrics>, jobs: usize, chunk: Duration) -> (Land, Generation) {
        let land = Land::new(1);
        let limits = Limits {
            threads: 1,
            cache_bytes: 1 << 24,
            jobs,
            deadline: Duration::from_secs(30),
            without: None,
        };
        let source = Slow(ProceduralSource::new(land), chunk);
        (land, Generation::new(source, limits, Arc::clone(metrics)).unwrap())
    }

    fn anyone<'a>(generation: &'a Generation, bucket: &'a TokenBucket) -> Requester<'a> {
        Requester { client: None, generation, bucket }
    }

    /// A bucket of `ms` milliseconds per second.
    fn bucket(ms: u64) -> TokenBucket {
        RateLimiter::new(Some(ms)).bucket(Some("10.0.0.1".parse().unwrap()))
    }

    #[tokio::test]
    async fn the_rendering_of_a_tile_is_charged_and_is_no_cost_of_a_chunk() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 100);
        let map = || Map::new(land.digest(), 1 << 20, 1, Arc::clone(&metrics));
        // Its chunks are made without a charge.
        map().tile(key(4, 0, -1), anyone(&generation, &TokenBucket::default())).await.unwrap();
        let bucket = bucket(1);
        let (before, start) = (bucket.tokens(), Instant::now());
        map().tile(key(4, 0, -1), anyone(&generation, &bucket)).await.unwrap();
        assert_eq!(metrics.http.tiles_rendered.get(), 2);
        assert!(bucket.tokens() < before);
        // The full bucket pays for 10,000 chunks of the least cost, that of no chunk.
        assert_eq!(bucket.affordable_chunks(Duration::ZERO, start + Duration::from_secs(3600)), 10_000);
    }

    #[tokio::test(start_paused = true)]
    async fn a_tile_waits_for_tokens_before_each_chunk_and_leaves_its_place_to_others() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = slow_service(&metrics, 100, Duration::from_millis(40));
        let map = Arc::new(Map::new(land.digest(), 1 << 20, 1, Arc::clone(&metrics)));
        let limited = bucket(1);
        // Its request was admitted; meanwhile others have spent the tokens and 40 s of refill more.
        limited.charge_work(50_000, Instant::now());
        let over = map.tile(key(4, 0, -1), anyone(&generation, &limited)).await;
        assert_eq!(over.err(), Some(MapError::OverRate), "the deadline is 30 s");
        assert_eq!(
            (metrics.generation.jobs_completed.get(), metrics.limits.rate_limit_rejections.get()),
            (0, 1)
        );

        // 10 ms pay for one of the 36 chunks, of 1.4 s together, and for those requested with it.
        // The threads refill the bucket by the real time: on a busy machine it gets more, and
        // chunks take longer. Up to 14 s of the one, and up to 3 s of the other, do not change the
        // result.
        let tile = {
            let (map, generation, short) = (Arc::clone(&map), generation.clone(), bucket(100));
            short.charge_work(990_000, Instant::now());
            tokio::spawn(async move { map.tile(key(4, 0, -1), anyone(&generation, &short)).await.map(drop) })
        };
        while metrics.limits.rate_limit_delays.get() == 0 {
            assert!(!tile.is_finished(), "without a delay");
            tokio::task::yield_now().await;
        }
        let made = metrics.generation.jobs_completed.get();
        assert!((1..36).contains(&made), "{made}");
        assert_eq!(map.turns.free(), 1);
        // The control: the same tile for another client, which takes up the chunks that are made.
        assert!(map.tile(key(4, 0, -1), anyone(&generation, &TokenBucket::default())).await.is_ok());
        assert_eq!((metrics.generation.jobs_completed.get(), metrics.http.tiles_rendered.get()), (36, 1));
        tile.abort();
    }

    #[tokio::test]
    async fn a_network_with_many_tiles_delays_one_of_another_by_few() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 100);
        let map = Arc::new(Map::new(land.digest(), 1 << 24, 1, Arc::clone(&metrics)));
        let begin = |address: [u8; 4], x: i32| {
            let (map, generation) = (Arc::clone(&map), generation.clone());
            let client = Some(IpAddr::from(address));
            tokio::spawn(async move {
                map.tile(key(0, x, 0), Requester { client, ..anyone(&generation, &TokenBucket::default()) })
                    .await
                    .map(drop)
            })
        };
        let many: Vec<_> = (0..40).map(|x| begin([10, 0, 0, 1], x)).collect();
        tokio::task::yield_now().await;
        begin([10, 0, 0, 2], -1).await.unwrap().unwrap();
        // One is being rendered, one is in line before it, one may follow before it is counted.
        assert!(metrics.http.tiles_rendered.get() <= 4, "{}", metrics.http.tiles_rendered.get());
        for tile in many {
            tile.await.unwrap().unwrap();
        }
        assert_eq!(metrics.http.tiles_rendered.get(), 41);
    }

    fn key(level: u8, x: i32, z: i32) -> ChunkKey {
        ChunkKey::new(level, x, z).unwrap()
    }

    #[tokio::test]
    async fn a_tile_requests_few_chunks_at_once_and_is_rendered_once() {
        let metrics = Arc::new(Metrics::default());
        // The queue has exactly the size of the window.
        let (land, generation) = service(&metrics, JOB_WINDOW);
        let map = Map::new(land.digest(), 1 << 20, 1, Arc::clone(&metrics));
        let tile = map.tile(key(4, 0, -1), anyone(&generation, &TokenBucket::default())).await.unwrap();
        assert_eq!(metrics.generation.jobs_completed.get(), 36);
        assert_eq!(
            map.tile(key(4, 0, -1), anyone(&generation, &TokenBucket::default())).await.unwrap().digest,
            tile.digest
        );
        assert_eq!((metrics.http.tiles_rendered.get(), metrics.http.tile_cache_hits.get()), (1, 1));
        // Its neighbour to the east shares two columns of six chunks with it.
        map.tile(key(4, 1, -1), anyone(&generation, &TokenBucket::default())).await.unwrap();
        assert_eq!(metrics.generation.jobs_completed.get(), 36 + 24);
        // The control: with a smaller queue than the window it is rejected.
        let (_, small) = service(&metrics, 2);
        let rejected = map.tile(key(4, 5, 5), anyone(&small, &TokenBucket::default())).await;
        assert_eq!(rejected.err(), Some(MapError::Generation(GenerationError::Overloaded)));
    }

    #[tokio::test]
    async fn a_tile_over_the_limit_is_rejected_and_others_continue() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 100);
        let map = Arc::new(Map {
            queue_permits: Semaphore::new(2),
            ..Map::new(land.digest(), 1 << 20, 1, Arc::clone(&metrics))
        });
        // The only turn is taken.
        let turn = map.turns.acquire(None).await.unwrap();
        let wait_for = |x| {
            let (map, generation) = (Arc::clone(&map), generation.clone());
            tokio::spawn(
                async move { map.tile(key(0, x, 0), anyone(&generation, &TokenBucket::default())).await },
            )
        };
        let waiting = [wait_for(1), wait_for(2)];
        while map.queue_permits.available_permits() > 0 {
            tokio::task::yield_now().await;
        }
        assert_eq!(wait_for(3).await.unwrap().err(), Some(MapError::Busy));
        drop(turn);
        for tile in waiting {
            assert!(tile.await.unwrap().is_ok());
        }
        assert!(wait_for(3).await.unwrap().is_ok(), "permits are released");
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_session_waits_for_two_map_windows_at_most() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 1000);
        let map = Arc::new(Map::new(land.digest(), 1 << 24, 1, Arc::clone(&metrics)));
        // All over the home island: some thousand expensive chunks.
        let tiles: Vec<_> = (-4..4)
            .flat_map(|x| (-4..4).map(move |z| key(4, x, z)))
            .map(|key| {
                let (map, generation) = (Arc::clone(&map), generation.clone());
                tokio::spawn(async move {
                    map.tile(key, anyone(&generation, &TokenBucket::default())).await.map(drop)
                })
            })
            .collect();
        while metrics.generation.jobs_completed.get() < 10
            || map.queue_permits.available_permits() > MAX_WAITING - 60
        {
            tokio::task::yield_now().await;
        }
        let mut waits = Vec::new();
        for z in 0..30 {
            let before = metrics.generation.jobs_completed.get();
            let chunk = ChunkRequest { key: key(0, 20, z), request: None, priority: 0 };
            generation.flow().frame(chunk, Delivery::Exact).await.unwrap();
            waits.push(metrics.generation.jobs_completed.get() - before);
        }
        waits.sort_unstable();
        // Its own chunk, the window of the map, and one window queued behind it. In nine of ten
        // cases: the count begins before the request and ends after the result, and this thread may
        // be descheduled in between.
        assert!(waits[26] <= 1 + 2 * JOB_WINDOW as u64, "chunks generated during one request: {waits:?}");
        // The control: the map had more tiles to render all the time.
        assert!(
            map.queue_permits.available_permits() < MAX_WAITING - 10,
            "{}",
            map.queue_permits.available_permits()
        );
        tiles.iter().for_each(tokio::task::JoinHandle::abort);
    }

    #[tokio::test]
    async fn the_tile_cache_stays_within_its_bytes() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 100);
        let budget = 300 << 10;
        let map = Map::new(land.digest(), budget, 1, Arc::clone(&metrics));
        let mut rendered = 0;
        for x in 0..12 {
            rendered +=
                map.tile(key(0, x, 3), anyone(&generation, &TokenBucket::default())).await.unwrap().png.len()
                    as u64;
        }
        assert!(rendered > 2 * budget, "{rendered} bytes exceed the budget");
        assert!(map.cache.weight() <= budget && map.cache.weight() > 0);
    }
}
