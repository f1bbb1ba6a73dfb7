//! Resident chunks: a fixed number of slots, filled and emptied by least recent use.
//!
//! The number of slots comes from the memory budget and never changes; nothing that a peer sends
//! makes this grow.

use crate::world::error::{self, Rises};
use rustc_hash::{FxHashMap, FxHashSet};
use shaders::layout::{BLOCK_TEXELS, GPU_SLOT_BYTES};
use std::time::Duration;
use terrain::constants::VERTEX_COUNT;
use terrain::pyramid::PYRAMID_LEVELS;
use terrain::{Chunk, ChunkKey, GrassSeed, Land, Pyramid};

/// Memory that one slot stands for, bytes: heights, bounds, rises and grass here, and what the GPU
/// holds of a chunk.
pub const SLOT_BYTES: usize = 4 * (VERTEX_COUNT + 2 * BLOCK_TEXELS)
    + size_of::<Rises>()
    + terrain::constants::GRASS_GRID.pow(2)
    + GPU_SLOT_BYTES;

/// The level of the max pyramid with 8 x 8 blocks, the finest that is kept.
const BLOCK_LEVEL: usize = 3;

/// A chunk that is here.
#[derive(Clone, Debug)]
pub struct Resident {
    /// Slot of its heights in the pool.
    pub slot: u32,
    /// Heights in units, row by row; the ground under the camera is read from them.
    pub heights: Box<[i32; VERTEX_COUNT]>,
    /// Upper bounds of the drawn surface in units: 8 x 8 blocks row by row, then 4 x 4, 2 x 2, 1.
    pub maxima: [i32; BLOCK_TEXELS],
    /// Lower bounds of it, likewise.
    pub minima: [i32; BLOCK_TEXELS],
    /// What grows on it.
    pub grass: GrassSeed,
    /// Bound of the vertical error against level 0, units.
    pub error: u32,
    /// Lowest vertex, units.
    pub min: i32,
    /// Highest vertex, units.
    pub max: i32,
    /// How far it rises over its parent or falls below, where that has been here with it.
    pub rises: Option<Rises>,
    /// Last frame whose selection drew this chunk or something below it.
    used: u64,
    /// Frame in which it arrived.
    arrived: u64,
}

/// What an insertion did.
#[derive(Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Slot whose heights must be uploaded; none if the chunk was already here.
    pub slot: Option<u32>,
    /// Chunks that had to leave, to be released at the server.
    pub evicted: Vec<ChunkKey>,
    /// Whether a chunk had to leave that the current picture uses, or that was sent for the current
    /// view: the budget is too small for it, and the same chunks would come and go without end.
    pub starved: bool,
}

/// The resident chunks.
#[derive(Debug)]
pub struct World {
    chunks: FxHashMap<ChunkKey, Resident>,
    free: Vec<u32>,
    capacity: u32,
    frame: u64,
    /// Frame in which the current view was said.
    view_said: u64,
    /// Whether a view was once covered from end to end.
    covered: bool,
    /// Since when each chunk that is drawn by its children has been.
    split_since: FxHashMap<ChunkKey, Duration>,
    /// The land that is said to be served.
    land: Option<Land>,
    /// How much higher than that the resident chunks are, Q8.
    stretch: i32,
}

impl World {
    /// An empty world with `capacity` slots (at least 1).
    #[must_use]
    pub fn new(capacity: u32) -> Self {
        let capacity = capacity.max(1);
        Self {
            chunks: FxHashMap::default(),
            free: (0..capacity).rev().collect(),
            capacity,
            // Starts above the stamp of chunks that no selection has used.
            frame: 1,
            view_said: 1,
            covered: false,
            split_since: FxHashMap::default(),
            land: None,
            stretch: super::stretch::ONE,
        }
    }

    /// Slots that fit into a budget of bytes.
    #[must_use]
    pub fn capacity_for(budget: usize) -> u32 {
        u32::try_from(budget / SLOT_BYTES).unwrap_or(u32::MAX).max(1)
    }

    /// Takes a chunk in, making room if needed. The caller uploads the heights and releases the
    /// evicted keys.
    pub fn insert(&mut self, chunk: Chunk) -> Arrival {
        if self.chunks.contains_key(&chunk.key) {
            return Arrival { slot: None, evicted: Vec::new(), starved: false };
        }
        let (mut evicted, mut starved) = (Vec::new(), false);
        if self.free.is_empty() {
            (evicted, starved) = self.make_room();
        }
        // Room was made: the capacity is at least 1 and all slots are either free or resident.
        let Some(slot) = self.free.pop() else { return Arrival { slot: None, evicted, starved } };
        let (min, max) = (chunk.min(), chunk.max());
        let resident = Resident {
            slot,
            maxima: blocks(&chunk.max_pyramid),
            minima: blocks(&chunk.min_pyramid),
            grass: chunk.grass,
            heights: chunk.heights,
            error: chunk.error,
            min,
            max,
            rises: None,
            used: 0,
            arrived: self.frame,
        };
        self.chunks.insert(chunk.key, resident);
        self.compare_with_parent(chunk.key);
        for child in chunk.key.children().into_iter().flatten() {
            self.compare_with_parent(child);
        }
        Arrival { slot: Some(slot), evicted, starved }
    }

    /// Finds a chunk's rises, if it and its parent are here and they are not known yet.
    fn compare_with_parent(&mut self, key: ChunkKey) {
        let parent = key.parent().and_then(|parent| self.chunks.get(&parent));
        let (Some(parent), Some(chunk)) = (parent, self.chunks.get(&key)) else { return };
        if chunk.rises.is_none() {
            let rises = error::rises(key, &chunk.heights, &parent.heights);
            self.chunks.entry(key).and_modify(|chunk| chunk.rises = Some(rises));
        }
    }

    /// Notes that all chunks come stretched by so many 256ths.
    pub fn set_stretch(&mut self, stretch: i32) {
        self.stretch = stretch;
    }

    /// How much higher than the true land the resident chunks are, Q8.
    #[must_use]
    pub fn stretch(&self) -> i32 {
        self.stretch
    }

    /// Notes the seed that the served land is said to be made from.
    pub fn set_seed(&mut self, world_seed: u64) {
        self.land = Some(Land::new(world_seed));
    }

    /// The noise behind the land, as far as the server tells the truth: for comparisons, never for
    /// what is drawn.
    #[must_use]
    pub fn land(&self) -> Option<&Land> {
        self.land.as_ref()
    }

    /// The chunk of a key, if it is here.
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

    /// Whether no chunk is here.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.chunks.is_empty()
    }

    /// Slots, used or not.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.capacity
    }

    /// Chunks at each level, 0 to 16.
    #[must_use]
    pub fn level_histogram(&self) -> [u32; 17] {
        let mut histogram = [0; 17];
        for key in self.chunks.keys() {
            histogram[usize::from(key.level())] += 1;
        }
        histogram
    }

    /// Height of the finest resident ground at a place (units), units.
    #[must_use]
    pub fn ground(&self, x: i32, z: i32) -> Option<i32> {
        let key = (0..=terrain::constants::TOP_LEVEL)
            .map(|level| ChunkKey::containing(level, x, z))
            .find(|key| self.chunks.contains_key(key))?;
        let (x0, z0) = key.origin();
        let cell = |value: i32, low: i32| {
            ((i64::from(value) - i64::from(low)) / i64::from(key.spacing())).clamp(0, 63) as usize
        };
        let (column, row) = (cell(x, x0), cell(z, z0));
        let heights = &self.chunks.get(&key)?.heights;
        // The highest corner of the cell: a camera kept above it is above both triangles.
        [0, 1, 65, 66].into_iter().map(|step| heights[row * 65 + column + step]).max()
    }

    /// Notes that another view was said: what arrived for the last one may go.
    pub fn view_said(&mut self) {
        self.view_said = self.frame + 1;
    }

    /// Starts the selection of a new frame, of whose coarsest chunks all or not all are here.
    /// Whether the land can be shown: not before it once covered a whole view, because a part of it
    /// would end in mid-air. Later on what is missing is new at the far end of the view.
    pub(super) fn begin_frame(&mut self, all_tops_are_here: bool) -> bool {
        self.frame += 1;
        self.covered |= all_tops_are_here;
        self.covered
    }

    /// Notes which chunks are drawn by their children now.
    pub(super) fn note_splits(&mut self, split: &FxHashSet<ChunkKey>, now: Duration) {
        self.split_since.retain(|key, _| split.contains(key));
        for key in split {
            self.split_since.entry(*key).or_insert(now);
        }
    }

    /// Since when a chunk has been drawn by its children, if it is.
    pub(super) fn split_since(&self, key: ChunkKey) -> Option<Duration> {
        self.split_since.get(&key).copied()
    }

    /// Notes that the current selection draws a chunk, or something below it.
    pub(super) fn touch(&mut self, key: ChunkKey) {
        if let Some(chunk) = self.chunks.get_mut(&key) {
            chunk.used = self.frame;
        }
    }

    /// Evicts the least useful chunk and, as far as they are not in use, up to 1/64 of the others
    /// with it: the search is linear, so it pays to do it rarely.
    ///
    /// In use are the drawn chunks and those above them, which stand in when a drawn one goes. Only
    /// when nothing else is left one of them is taken, the finest first: the picture gets coarser
    /// there, and no hole.
    fn make_room(&mut self) -> (Vec<ChunkKey>, bool) {
        let (frame, view_said) = (self.frame, self.view_said);
        let mut order: Vec<(bool, u64, u8, ChunkKey, bool)> = self
            .chunks
            .iter()
            .map(|(key, chunk)| {
                let in_use = chunk.used == frame;
                let missed = in_use || chunk.arrived >= view_said;
                (in_use, chunk.used.max(chunk.arrived), key.level(), *key, missed)
            })
            .collect();
        order.sort_unstable();
        let batch = (self.capacity as usize / 64).max(1);
        let (mut evicted, mut starved) = (Vec::new(), false);
        for (index, (_, _, _, key, missed)) in order.into_iter().take(batch).enumerate() {
            if index > 0 && missed {
                break;
            }
            starved |= missed;
            self.remove(key);
            evicted.push(key);
        }
        (evicted, starved)
    }

    fn remove(&mut self, key: ChunkKey) {
        if let Some(chunk) = self.chunks.remove(&key) {
            self.free.push(chunk.slot);
        }
    }
}

/// The top of a pyramid, from 8 x 8 blocks up.
fn blocks(pyramid: &Pyramid) -> [i32; BLOCK_TEXELS] {
    let mut texels = (BLOCK_LEVEL..PYRAMID_LEVELS).flat_map(|level| pyramid.level(level).iter().copied());
    // Four levels hold exactly that many texels; nothing is ever filled up.
    std::array::from_fn(|_| texels.next().unwrap_or(i32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::select;
    use std::collections::HashSet;
    use terrain::lod::Viewer;

    fn chunk(level: u8, x: i32, z: i32) -> Chunk {
        Land::new(1).chunk(ChunkKey::new(level, x, z).unwrap())
    }

    #[test]
    fn a_chunk_gets_a_slot_once_and_slots_are_never_shared() {
        let mut world = World::new(8);
        let mut slots = HashSet::new();
        for x in 0..8 {
            let arrival = world.insert(chunk(0, x + 60, 60));
            assert!(slots.insert(arrival.slot.unwrap()) && arrival.evicted.is_empty());
        }
        assert_eq!(world.insert(chunk(0, 60, 60)).slot, None);
        assert_eq!(world.len(), 8);
    }

    #[test]
    fn the_budget_is_never_exceeded_and_evicted_keys_are_reported() {
        let mut world = World::new(3);
        let mut resident = HashSet::new();
        for x in 0..20 {
            let arrived = chunk(0, x + 60, 60);
            resident.insert(arrived.key);
            for key in world.insert(arrived).evicted {
                assert!(resident.remove(&key), "{key} was not here");
            }
            assert!(world.len() <= 3);
            assert_eq!(world.keys().collect::<HashSet<_>>(), resident);
        }
    }

    #[test]
    fn what_is_drawn_stays_until_nothing_else_is_left() {
        let viewer =
            Viewer { eye: (16_384, 25_600, 16_384), distance_m: 60, pixels_per_radian: 300, tolerance_q4: 1 };
        let mut world = World::new(4);
        let drawn = chunk(0, 0, 0).key;
        world.insert(chunk(0, 0, 0));
        world.insert(chunk(0, 70, 60));
        world.insert(chunk(0, 71, 60));
        world.insert(chunk(0, 72, 60));
        assert_eq!(select(&mut world, &viewer).drawn[0].key, drawn);
        world.view_said();
        select(&mut world, &viewer);
        for x in 80..83 {
            let arrival = world.insert(chunk(0, x, 60));
            assert!(!arrival.evicted.contains(&drawn) && !arrival.starved);
        }

        let mut tiny = World::new(1);
        tiny.insert(chunk(0, 0, 0));
        select(&mut tiny, &viewer);
        let arrival = tiny.insert(chunk(0, 60, 60));
        assert!(arrival.starved && arrival.evicted == [drawn]);
    }

    #[test]
    fn the_ground_is_read_from_the_finest_chunk_that_is_here() {
        let mut world = World::new(4);
        assert_eq!(world.ground(100, 100), None);
        world.insert(chunk(3, 0, 0));
        let coarse = world.ground(100, 100).unwrap();
        world.insert(chunk(0, 0, 0));
        let fine = world.ground(100, 100).unwrap();
        let land = Land::new(1);
        let truth = land.height_at(terrain::Position::new(100, 100).unwrap());
        assert!((fine - truth).abs() <= (coarse - truth).abs().max(512), "{coarse} {fine} {truth}");
    }
}
