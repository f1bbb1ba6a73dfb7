//! The relief map: pictures of the chunks that the server sends, one tile for the square of each
//! chunk key.
//!
//! The map is a guest. All tiles together are one client of the generation service for every four
//! of its threads, so that they get at most that share of its turns; tiles that wait are counted
//! and bounded, and finished ones lie in a cache of bytes. Reading order: [`relief`] (heights from
//! chunks), [`paint`] (colours from heights).

pub mod paint;
pub mod relief;

use crate::generation::{Flow, Generation, GenerationError};
use crate::metrics::Metrics;
use crate::purse::Purse;
use bytes::Bytes;
use protocol::server::Wanted;
use protocol::{Delivery, chunk_codec};
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use relief::Relief;
use std::sync::Arc;
use std::time::Duration;
use terrain::{Chunk, ChunkKey, WorldDigest};
use thiserror::Error;
use tokio::sync::Semaphore;
use tokio::time::{Instant, timeout};

/// Pixels along one side of a tile.
pub const TILE_PIXELS: usize = 256;

/// Counts changes of colours and shading. Part of the tiles' addresses, since a tile may be kept
/// for ever.
pub const STYLE: u32 = 1;

/// Tiles that may wait to be painted. About three browser windows full; one more is refused.
const MAX_WAITING: usize = 96;

/// Longest wait for a turn. Whoever asked has scrolled on.
const PATIENCE: Duration = Duration::from_secs(10);

/// Chunks of one tile in generation at once, as [`crate::socket`] has for a session: all at once
/// would make the last wait for the first, and be refused where the deadline is short.
const JOB_WINDOW: usize = 8;

/// Bytes a tile takes besides its picture: key, digest, handle and the map's own share.
const TILE_OVERHEAD: u64 = 160;

/// Why a tile cannot be had now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MapError {
    /// Too many tiles wait already, or this one waited for too long.
    #[error("too many tiles of the map are asked for at once, ask again later")]
    Busy,
    /// One of its chunks cannot be had.
    #[error(transparent)]
    Generation(#[from] GenerationError),
}

/// A finished tile.
#[derive(Clone, Debug)]
pub struct Tile {
    /// The picture: PNG, RGB, [`TILE_PIXELS`] a side.
    pub png: Bytes,
    /// Of the picture's bytes.
    pub digest: [u8; 16],
}

/// Paints and keeps tiles.
pub struct Map {
    world: WorldDigest,
    cache: Cache<ChunkKey, Tile, TileWeight>,
    /// One permit for each tile being painted. Whoever paints keeps it to the end, even if nobody
    /// waits for the tile any more: clients that ask and leave must not get more painted at once
    /// than others.
    painting: Arc<Semaphore>,
    /// One permit for each tile that is being painted or waits for it.
    places: Semaphore,
}

#[derive(Clone)]
struct TileWeight;

impl Weighter<ChunkKey, Tile> for TileWeight {
    fn weight(&self, _key: &ChunkKey, tile: &Tile) -> u64 {
        tile.png.len() as u64 + TILE_OVERHEAD
    }
}

impl Map {
    /// A map whose tiles may take so many bytes; `threads` is that of the generation service.
    #[must_use]
    pub fn new(world: WorldDigest, cache_bytes: u64, threads: usize) -> Self {
        // About 64 KiB a tile of land; the estimate only sizes the first tables.
        let cache = Cache::with_weighter((cache_bytes >> 16) as usize, cache_bytes, TileWeight);
        Self {
            world,
            cache,
            painting: Arc::new(Semaphore::new(threads.div_ceil(4))),
            places: Semaphore::new(MAX_WAITING),
        }
    }

    /// The tile of a key; what it costs to make and to send is taken out of a purse. Dropping the
    /// future withdraws everything that it waits for.
    ///
    /// # Errors
    /// See [`MapError`].
    pub async fn tile(
        &self,
        key: ChunkKey,
        generation: &Generation,
        purse: &Purse,
        metrics: &Metrics,
    ) -> Result<Tile, MapError> {
        let tile = self.tile_unsent(key, generation, purse, metrics).await?;
        purse.pay_bytes(tile.png.len(), Instant::now());
        Ok(tile)
    }

    async fn tile_unsent(
        &self,
        key: ChunkKey,
        generation: &Generation,
        purse: &Purse,
        metrics: &Metrics,
    ) -> Result<Tile, MapError> {
        metrics.tiles_requested.inc();
        if let Some(tile) = self.cache.get(&key) {
            metrics.tile_cache_hits.inc();
            return Ok(tile);
        }
        let _place = self.places.try_acquire().map_err(|_| MapError::Busy)?;
        // The semaphore is never closed; both failures mean that there was no turn.
        let turn = timeout(PATIENCE, Arc::clone(&self.painting).acquire_owned()).await;
        let Ok(Ok(turn)) = turn else { return Err(MapError::Busy) };
        // Whoever was painting may have painted this very tile.
        if let Some(tile) = self.cache.get(&key) {
            metrics.tile_cache_hits.inc();
            return Ok(tile);
        }
        let frames = frames(&relief::sources(key), generation, purse).await?;
        let (world, purse) = (self.world, purse.clone());
        // Milliseconds of computing: not for a thread that has sockets to serve.
        let painted = tokio::task::spawn_blocking(move || {
            let started = Instant::now();
            let tile = paint_tile(key, &frames, &world);
            let now = Instant::now();
            // Milliseconds.
            purse.pay_work((now - started).as_micros() as i64, now);
            drop(turn);
            tile
        })
        .await;
        let Ok(Some(tile)) = painted else { return Err(GenerationError::Failed.into()) };
        metrics.tiles_painted.inc();
        self.cache.insert(key, tile.clone());
        Ok(tile)
    }
}

/// The frames of chunks, in their order, as any client would get them.
async fn frames(
    keys: &[ChunkKey],
    generation: &Generation,
    purse: &Purse,
) -> Result<Vec<Bytes>, GenerationError> {
    let mut frames: Vec<Option<Bytes>> =
        keys.iter().map(|key| generation.cached(*key, Delivery::Exact)).collect();
    let missing: Vec<usize> = (0..keys.len()).filter(|index| frames[*index].is_none()).collect();
    let (mut flow, mut unasked): (Flow, _) = (generation.flow_paid_by(purse.clone()), missing.into_iter());
    loop {
        while flow.open() < JOB_WINDOW {
            let Some(index) = unasked.next() else { break };
            // Named by its place, so that the answer finds its way.
            let wanted = Wanted { key: keys[index], request: Some(index as u32), priority: u64::MAX };
            flow.ask(wanted, Delivery::Exact);
        }
        if flow.open() == 0 {
            break;
        }
        for (wanted, answer) in flow.answers().await {
            if let Some(place) = wanted.request.and_then(|index| frames.get_mut(index as usize)) {
                *place = Some(answer?);
            }
        }
    }
    frames.into_iter().collect::<Option<Vec<_>>>().ok_or(GenerationError::Failed)
}

/// Paints a tile; none if a frame is damaged, which would be a fault of this server.
fn paint_tile(key: ChunkKey, frames: &[Bytes], world: &WorldDigest) -> Option<Tile> {
    let chunks: Option<Vec<Chunk>> =
        frames.iter().map(|frame| chunk_codec::decode(frame, world).ok()).collect();
    let pixels = paint::paint(&Relief::of(key, &chunks?), key.level());
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
    use crate::generation::Limits;
    use crate::source::Procedural;
    use terrain::Land;

    fn service(metrics: &Arc<Metrics>, jobs: usize) -> (Land, Generation) {
        let land = Land::new(1);
        let limits = Limits { threads: 1, cache_bytes: 1 << 24, jobs, deadline: Duration::from_secs(30) };
        (land, Generation::new(Procedural::new(land), limits, Arc::clone(metrics)).unwrap())
    }

    fn key(level: u8, x: i32, z: i32) -> ChunkKey {
        ChunkKey::new(level, x, z).unwrap()
    }

    #[tokio::test]
    async fn a_tile_asks_for_few_chunks_at_once_and_is_painted_once() {
        let metrics = Arc::new(Metrics::default());
        // No room for one job more than the window.
        let (land, generation) = service(&metrics, JOB_WINDOW);
        let map = Map::new(land.digest(), 1 << 20, 1);
        let tile = map.tile(key(4, 0, -1), &generation, &Purse::default(), &metrics).await.unwrap();
        assert_eq!(metrics.generated.get(), 36);
        assert_eq!(
            map.tile(key(4, 0, -1), &generation, &Purse::default(), &metrics).await.unwrap().digest,
            tile.digest
        );
        assert_eq!((metrics.tiles_painted.get(), metrics.tile_cache_hits.get()), (1, 1));
        // Its neighbour to the east shares two columns of six chunks with it.
        map.tile(key(4, 1, -1), &generation, &Purse::default(), &metrics).await.unwrap();
        assert_eq!(metrics.generated.get(), 36 + 24);
        // The control: with less room than the window it is refused.
        let (_, small) = service(&metrics, 2);
        let refused = map.tile(key(4, 5, 5), &small, &Purse::default(), &metrics).await;
        assert_eq!(refused.err(), Some(MapError::Generation(GenerationError::Overloaded)));
    }

    #[tokio::test]
    async fn one_tile_too_many_is_refused_and_the_others_go_on() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 100);
        let map = Arc::new(Map { places: Semaphore::new(2), ..Map::new(land.digest(), 1 << 20, 1) });
        // Somebody paints, so that nobody else has a turn.
        let painter = map.painting.acquire().await.unwrap();
        let wait_for = |x| {
            let (map, generation, metrics) = (Arc::clone(&map), generation.clone(), Arc::clone(&metrics));
            tokio::spawn(
                async move { map.tile(key(0, x, 0), &generation, &Purse::default(), &metrics).await },
            )
        };
        let waiting = [wait_for(1), wait_for(2)];
        while map.places.available_permits() > 0 {
            tokio::task::yield_now().await;
        }
        assert_eq!(wait_for(3).await.unwrap().err(), Some(MapError::Busy));
        drop(painter);
        for tile in waiting {
            assert!(tile.await.unwrap().is_ok());
        }
        assert!(wait_for(3).await.unwrap().is_ok(), "places are given back");
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_stream_waits_for_a_turn_or_two_of_the_map_however_many_tiles_are_asked_for() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 1000);
        let map = Arc::new(Map::new(land.digest(), 1 << 24, 1));
        // All over the home island: some thousand chunks that cost much.
        let tiles: Vec<_> = (-4..4)
            .flat_map(|x| (-4..4).map(move |z| key(4, x, z)))
            .map(|key| {
                let (map, generation, metrics) = (Arc::clone(&map), generation.clone(), Arc::clone(&metrics));
                tokio::spawn(async move {
                    map.tile(key, &generation, &Purse::default(), &metrics).await.map(drop)
                })
            })
            .collect();
        while metrics.generated.get() < 10 || map.places.available_permits() > MAX_WAITING - 60 {
            tokio::task::yield_now().await;
        }
        let mut waits = Vec::new();
        for z in 0..30 {
            let before = metrics.generated.get();
            let wanted = Wanted { key: key(0, 20, z), request: None, priority: 0 };
            generation.flow().frame(wanted, Delivery::Exact).await.unwrap();
            waits.push(metrics.generated.get() - before);
        }
        waits.sort_unstable();
        // Its own, what the map had in the window, and a window more that came behind. Nine times
        // of ten: what is counted begins before the asking and ends after the answer, and a machine
        // with other work may stop this thread there.
        assert!(waits[26] <= 1 + 2 * JOB_WINDOW as u64, "chunks made while one was waited for: {waits:?}");
        // The control: the map had far more to ask for all the time.
        assert!(map.places.available_permits() < MAX_WAITING - 10, "{}", map.places.available_permits());
        tiles.iter().for_each(tokio::task::JoinHandle::abort);
    }

    #[tokio::test]
    async fn tiles_stay_within_their_bytes() {
        let metrics = Arc::new(Metrics::default());
        let (land, generation) = service(&metrics, 100);
        let budget = 300 << 10;
        let map = Map::new(land.digest(), budget, 1);
        let mut painted = 0;
        for x in 0..12 {
            painted +=
                map.tile(key(0, x, 3), &generation, &Purse::default(), &metrics).await.unwrap().png.len()
                    as u64;
        }
        assert!(painted > 2 * budget, "{painted} bytes are more than fit");
        assert!(map.cache.weight() <= budget && map.cache.weight() > 0);
    }
}
