//! The chunk cache: a fixed number of slots, evicted by least recent use.
//!
//! The memory budget sets the number of slots; no message from a server changes it.

use crate::cache::block_errors::{BlockErrors, block_errors};
use crate::cache::vertical_scale;
use rustc_hash::{FxHashMap, FxHashSet};
use shaders::layout::{BLOCK_TEXELS, GPU_SLOT_BYTES};
use std::time::Duration;
use terrain::constants::VERTEX_COUNT;
use terrain::lod::Viewer;
use terrain::pyramid::PYRAMID_LEVELS;
use terrain::{Chunk, ChunkKey, GrassSeed, Land, Pyramid, WorldDigest};

/// Memory of one slot, bytes: heights, bounds, block errors and grass on the CPU, and all GPU
/// buffers.
pub const SLOT_BYTES: usize = 4 * (VERTEX_COUNT + 2 * BLOCK_TEXELS)
    + size_of::<BlockErrors>()
    + terrain::constants::GRASS_GRID.pow(2)
    + GPU_SLOT_BYTES;

/// The level of the max pyramid with 8 x 8 blocks, the finest one that is kept.
const BLOCK_LEVEL: usize = 3;

/// A resident chunk.
#[derive(Clone, Debug)]
pub struct Resident {
    /// Slot in the GPU pool.
    pub slot: u32,
    /// Heights in units, row by row; also the ground under the camera.
    pub heights: Box<[i32; VERTEX_COUNT]>,
    /// Upper bounds of the drawn surface in units: 8 x 8 blocks row by row, then 4 x 4, 2 x 2, 1.
    pub maxima: [i32; BLOCK_TEXELS],
    /// Lower bounds, in the same order.
    pub minima: [i32; BLOCK_TEXELS],
    /// Vegetation densities.
    pub grass: GrassSeed,
    /// Bound of the vertical error against level 0, units; without the rounding of quantised
    /// chunks.
    pub error: u32,
    /// The same of the unscaled land, which a server selects by.
    pub served_error: u32,
    /// Lowest vertex, units.
    pub min: i32,
    /// Highest vertex, units.
    pub max: i32,
    /// Errors against its parent, once both were resident together.
    pub block_errors: Option<BlockErrors>,
    /// Last frame that drew this chunk or a descendant.
    used: u64,
    /// Frame of its arrival.
    arrived: u64,
}

impl Resident {
    /// Four vegetation densities, packed in order.
    #[must_use]
    pub fn density_word(&self, word: usize) -> u32 {
        u32::from_le_bytes(std::array::from_fn(|byte| self.grass.density[4 * word + byte]))
    }
}

/// Result of an insertion.
#[derive(Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Slot to upload; none if the chunk was already resident.
    pub slot: Option<u32>,
    /// Evicted chunks, to be released at the server.
    pub evicted: Vec<ChunkKey>,
    /// Whether the current frame uses an evicted chunk, or an evicted chunk was sent for the
    /// current view: the budget is too small, and the same chunks would be sent and evicted
    /// forever.
    pub thrashing: bool,
}

/// Resident chunks by key.
#[derive(Debug)]
pub struct ChunkCache {
    chunks: FxHashMap<ChunkKey, Resident>,
    free: Vec<u32>,
    capacity: u32,
    frame: u64,
    /// Frame in which the current view was sent.
    view_sent: u64,
    /// View distance of the last view whose coarsest chunks were all resident, metres.
    covered_m: Option<u32>,
    /// Time at which each split chunk was first drawn by its children.
    split_since: FxHashMap<ChunkKey, Duration>,
    /// The land of the seed that the server states.
    land: Option<Land>,
    /// Digest of the served world. None if the stated seed gives a world with another digest.
    verified: Option<WorldDigest>,
    /// Vertical scale of the resident chunks, Q8.
    vertical_scale: i32,
}

impl ChunkCache {
    /// An empty cache with `capacity` slots (at least 1).
    #[must_use]
    pub fn new(capacity: u32) -> Self {
        let capacity = capacity.max(1);
        Self {
            chunks: FxHashMap::default(),
            free: (0..capacity).rev().collect(),
            capacity,
            // Above the stamp of chunks that no selection has used.
            frame: 1,
            view_sent: 1,
            covered_m: None,
            split_since: FxHashMap::default(),
            land: None,
            verified: None,
            vertical_scale: vertical_scale::ONE,
        }
    }

    /// Slots that fit into a budget of bytes.
    #[must_use]
    pub fn capacity_for(budget: usize) -> u32 {
        u32::try_from(budget / SLOT_BYTES).unwrap_or(u32::MAX).max(1)
    }

    /// Inserts a chunk, scaled vertically, and evicts others if the cache is full. The caller
    /// uploads the chunk and releases the evicted keys.
    pub fn insert(&mut self, chunk: Chunk) -> Arrival {
        if self.chunks.contains_key(&chunk.key) {
            return Arrival { slot: None, evicted: Vec::new(), thrashing: false };
        }
        let (mut evicted, mut thrashing) = (Vec::new(), false);
        if self.free.is_empty() {
            (evicted, thrashing) = self.make_room();
        }
        // Cannot fail: the capacity is at least 1 and every slot is free or occupied.
        let Some(slot) = self.free.pop() else { return Arrival { slot: None, evicted, thrashing } };
        let served_error = chunk.error;
        let chunk = vertical_scale::scaled(chunk, self.vertical_scale);
        let (min, max) = (chunk.min(), chunk.max());
        let resident = Resident {
            slot,
            maxima: blocks(&chunk.max_pyramid),
            minima: blocks(&chunk.min_pyramid),
            grass: chunk.grass,
            heights: chunk.heights,
            error: chunk.error,
            served_error,
            min,
            max,
            block_errors: None,
            used: 0,
            arrived: self.frame,
        };
        self.chunks.insert(chunk.key, resident);
        self.compare_with_parent(chunk.key);
        for child in chunk.key.children().into_iter().flatten() {
            self.compare_with_parent(child);
        }
        Arrival { slot: Some(slot), evicted, thrashing }
    }

    /// Computes a chunk's block errors, if it and its parent are resident and they are not known.
    fn compare_with_parent(&mut self, key: ChunkKey) {
        let parent = key.parent().and_then(|parent| self.chunks.get(&parent));
        let (Some(parent), Some(chunk)) = (parent, self.chunks.get(&key)) else { return };
        if chunk.block_errors.is_none() {
            let block_errors = block_errors(key, &chunk.heights, &parent.heights);
            self.chunks.entry(key).and_modify(|chunk| chunk.block_errors = Some(block_errors));
        }
    }

    /// Sets the vertical scale of the chunks that are inserted from now on, Q8.
    pub fn set_vertical_scale(&mut self, vertical_scale: i32) {
        self.vertical_scale = vertical_scale;
    }

    /// Vertical scale of the resident chunks, Q8.
    #[must_use]
    pub fn vertical_scale(&self) -> i32 {
        self.vertical_scale
    }

    /// Sets the seed that the server states, and the digest of the world that it serves.
    pub fn set_world(&mut self, world_seed: u64, world: WorldDigest) {
        // The digest of a land takes some 30 ms: not again for every session with the same server.
        if self.verified == Some(world) && self.land.is_some_and(|land| land.world_seed() == world_seed) {
            return;
        }
        let land = Land::new(world_seed);
        (self.land, self.verified) = (Some(land), (land.digest() == world).then_some(world));
    }

    /// Sets the land that the chunks come from.
    pub fn set_land(&mut self, land: Land) {
        (self.land, self.verified) = (Some(land), Some(land.digest()));
    }

    /// The land of the chunks with its digest; none if the stated seed has another digest than the
    /// world.
    #[must_use]
    pub fn verified_land(&self) -> Option<(Land, WorldDigest)> {
        self.land.zip(self.verified)
    }

    /// The land of the stated seed, not verified: a server may state another seed than that of its
    /// chunks. For poses of the camera; what is drawn takes [`ChunkCache::verified_land`].
    #[must_use]
    pub fn land(&self) -> Option<&Land> {
        self.land.as_ref()
    }

    /// The chunk of a key, if resident.
    #[must_use]
    pub fn get(&self, key: ChunkKey) -> Option<&Resident> {
        self.chunks.get(&key)
    }

    /// Keys of all resident chunks, in no particular order.
    pub fn keys(&self) -> impl Iterator<Item = ChunkKey> + '_ {
        self.chunks.keys().copied()
    }

    /// All resident chunks, in no particular order.
    pub fn residents(&self) -> impl Iterator<Item = &Resident> {
        self.chunks.values()
    }

    /// Number of resident chunks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.chunks.len()
    }

    /// Whether no chunk is resident.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.chunks.is_empty()
    }

    /// Number of slots.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.capacity
    }

    /// Resident chunks at each level, 0 to 16.
    #[must_use]
    pub fn level_histogram(&self) -> [u32; 17] {
        let mut histogram = [0; 17];
        for key in self.chunks.keys() {
            histogram[usize::from(key.level())] += 1;
        }
        histogram
    }

    /// Height of the finest ground that can be drawn at a place (units), units: a resident chunk
    /// without its siblings is not drawn, its parent is.
    #[must_use]
    pub fn ground(&self, x: i32, z: i32) -> Option<i32> {
        let is_divisible = |key: &ChunkKey| {
            let mut children = key.children().into_iter().flatten();
            self.split_since.contains_key(key)
                || (key.level() > 0 && children.all(|child| self.chunks.contains_key(&child)))
        };
        let at = |level| ChunkKey::containing(level, x, z);
        let coarsest = (0..=terrain::constants::TOP_LEVEL).rev().map(at);
        let coarsest = coarsest.into_iter().find(|key| self.chunks.contains_key(key))?;
        let finer = |key: &ChunkKey| is_divisible(key).then(|| at(key.level() - 1));
        let key = std::iter::successors(Some(coarsest), finer)
            .take_while(|key| self.chunks.contains_key(key))
            .last()?;
        let (x0, z0) = key.origin();
        let cell = |value: i32, low: i32| {
            ((i64::from(value) - i64::from(low)) / i64::from(key.spacing())).clamp(0, 63) as usize
        };
        let (column, row) = (cell(x, x0), cell(z, z0));
        let heights = &self.chunks.get(&key)?.heights;
        // The highest corner of the cell: a camera kept above it is above both triangles.
        [0, 1, 65, 66].into_iter().map(|step| heights[row * 65 + column + step]).max()
    }

    /// Marks that a new view was sent: chunks that arrived for the previous one may be evicted.
    pub fn view_sent(&mut self) {
        self.view_sent = self.frame + 1;
    }

    /// Starts a frame. Returns the distance up to which land is drawn, metres. None until all
    /// visible chunks of the coarsest level were resident once: land with holes is not shown. A
    /// view with another coarsest level is drawn to the distance of the last covered one until its
    /// own coarsest chunks are resident.
    pub(crate) fn begin_frame(&mut self, viewer: &Viewer, has_all_tops: bool) -> Option<u32> {
        self.frame += 1;
        if has_all_tops {
            self.covered_m = Some(viewer.distance_m);
        }
        let covered = Viewer { distance_m: self.covered_m?, ..*viewer };
        let is_same = covered.top_level() == viewer.top_level();
        Some(if is_same { viewer.distance_m } else { covered.distance_m })
    }

    /// Updates the set of split chunks.
    pub(crate) fn note_splits(&mut self, split: &FxHashSet<ChunkKey>, now: Duration) {
        self.split_since.retain(|key, _| split.contains(key));
        for key in split {
            self.split_since.entry(*key).or_insert(now);
        }
    }

    /// Time at which a chunk was split, if it is.
    pub(crate) fn split_since(&self, key: ChunkKey) -> Option<Duration> {
        self.split_since.get(&key).copied()
    }

    /// Marks a chunk as used by the current frame.
    pub(crate) fn touch(&mut self, key: ChunkKey) {
        if let Some(chunk) = self.chunks.get_mut(&key) {
            chunk.used = self.frame;
        }
    }

    /// Evicts at least one chunk, and up to 1/64 of the capacity at once: the search is linear, and
    /// a batch makes it rare. The least recently used go first. After the first one, chunks are
    /// spared that are drawn or that arrived for the current view.
    ///
    /// Ancestors of drawn chunks count as drawn: they replace an evicted chunk. Drawn ones are
    /// evicted last, finest first, so that the surface gets coarser and no hole appears.
    fn make_room(&mut self) -> (Vec<ChunkKey>, bool) {
        let (frame, view_sent) = (self.frame, self.view_sent);
        let mut order: Vec<(bool, u64, u8, ChunkKey, bool)> = self
            .chunks
            .iter()
            .map(|(key, chunk)| {
                let in_use = chunk.used == frame;
                let is_needed = in_use || chunk.arrived >= view_sent;
                (in_use, chunk.used.max(chunk.arrived), key.level(), *key, is_needed)
            })
            .collect();
        order.sort_unstable();
        let batch = (self.capacity as usize / 64).max(1);
        let (mut evicted, mut thrashing) = (Vec::new(), false);
        for (index, (_, _, _, key, is_needed)) in order.into_iter().take(batch).enumerate() {
            if index > 0 && is_needed {
                break;
            }
            thrashing |= is_needed;
            self.remove(key);
            evicted.push(key);
        }
        (evicted, thrashing)
    }

    fn remove(&mut self, key: ChunkKey) {
        if let Some(chunk) = self.chunks.remove(&key) {
            self.free.push(chunk.slot);
        }
    }
}

/// The levels of a pyramid from 8 x 8 blocks up.
fn blocks(pyramid: &Pyramid) -> [i32; BLOCK_TEXELS] {
    let mut texels = (BLOCK_LEVEL..PYRAMID_LEVELS).flat_map(|level| pyramid.level(level).iter().copied());
    // Four levels hold exactly this many texels: the default is never used.
    std::array::from_fn(|_| texels.next().unwrap_or(i32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lod::select;
    use std::collections::HashSet;
    use terrain::lod::Viewer;

    fn chunk(level: u8, x: i32, z: i32) -> Chunk {
        Land::new(1).chunk(ChunkKey::new(level, x, z).unwrap())
    }

    #[test]
    fn each_chunk_gets_its_own_slot_once() {
        let mut cache = ChunkCache::new(8);
        let mut slots = HashSet::new();
        for x in 0..8 {
            let arrival = cache.insert(chunk(0, x + 60, 60));
            assert!(slots.insert(arrival.slot.unwrap()) && arrival.evicted.is_empty());
        }
        assert_eq!(cache.insert(chunk(0, 60, 60)).slot, None);
        assert_eq!(cache.len(), 8);
    }

    #[test]
    fn the_budget_is_never_exceeded_and_evicted_keys_are_reported() {
        let mut cache = ChunkCache::new(3);
        let mut resident = HashSet::new();
        for x in 0..20 {
            let arrived = chunk(0, x + 60, 60);
            resident.insert(arrived.key);
            for key in cache.insert(arrived).evicted {
                assert!(resident.remove(&key), "{key} was not resident");
            }
            assert!(cache.len() <= 3);
            assert_eq!(cache.keys().collect::<HashSet<_>>(), resident);
        }
    }

    #[test]
    fn drawn_chunks_are_evicted_last() {
        let viewer =
            Viewer { eye: (16_384, 25_600, 16_384), distance_m: 60, pixels_per_radian: 300, tolerance_q4: 1 };
        let mut cache = ChunkCache::new(4);
        let drawn = chunk(0, 0, 0).key;
        cache.insert(chunk(0, 0, 0));
        cache.insert(chunk(0, 70, 60));
        cache.insert(chunk(0, 71, 60));
        cache.insert(chunk(0, 72, 60));
        assert_eq!(select(&mut cache, &viewer).drawn[0].key, drawn);
        cache.view_sent();
        select(&mut cache, &viewer);
        for x in 80..83 {
            let arrival = cache.insert(chunk(0, x, 60));
            assert!(!arrival.evicted.contains(&drawn) && !arrival.thrashing);
        }

        let mut tiny = ChunkCache::new(1);
        tiny.insert(chunk(0, 0, 0));
        select(&mut tiny, &viewer);
        let arrival = tiny.insert(chunk(0, 60, 60));
        assert!(arrival.thrashing && arrival.evicted == [drawn]);
    }

    #[test]
    fn ground_height_is_that_of_the_finest_chunk_that_can_be_drawn() {
        let mut cache = ChunkCache::new(8);
        let ground = |cache: &ChunkCache| cache.ground(100, 100);
        assert_eq!(ground(&cache), None);
        // Of a level with fewer octaves, so that levels differ.
        let top = chunk(9, 0, 0);
        let children = top.key.children().unwrap().map(|key| Land::new(1).chunk(key));
        cache.insert(top);
        let coarse = ground(&cache);
        assert!(coarse.is_some());
        let [first, others @ ..] = children;
        let own = ChunkKey::containing(8, 100, 100);
        assert!(first.key == own || others.iter().any(|child| child.key == own));
        cache.insert(first);
        for child in others {
            assert_eq!(ground(&cache), coarse, "without its siblings a chunk is not drawn");
            cache.insert(child);
        }
        assert_ne!(ground(&cache), coarse);
        // A chunk below a level that is missing is not drawn either.
        let fine = ground(&cache);
        cache.insert(chunk(0, 0, 0));
        assert_eq!(ground(&cache), fine);
    }
}
