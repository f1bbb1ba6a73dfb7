//! Counts of culled plants, read without waiting for the GPU: copied with a frame, mapped after its
//! submission, and taken some frames later.

use crate::features::vegetation::gpu_cull::CullStats;
use crate::gpu::readback::{PendingRead, Readback, ReadbackError};
use shaders::layout::{FAR_LOST, INDIRECT_STATS};
use std::ops::Range;

/// Words of the indirect arguments of a species that hold its counts.
const SPECIES_WORDS: Range<usize> = INDIRECT_STATS..INDIRECT_STATS + 4;

/// Words of the state of far trees that hold theirs.
const FAR_WORDS: Range<usize> = 0..FAR_LOST + 1;

/// A recorded copy of the counts of a frame.
#[derive(Debug)]
pub struct StatsCopy {
    readback: Readback,
    species: usize,
    has_far_trees: bool,
    far_patches_lost: u32,
}

/// The counts on their way to the CPU.
#[derive(Debug)]
pub struct StatsRead {
    copy: StatsCopy,
    pending: PendingRead,
}

impl StatsCopy {
    /// Records copies of the counts: the indirect arguments of each species, and the state of far
    /// trees with the number of patches that had no room.
    #[must_use]
    pub fn record(
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        species: &[&wgpu::Buffer],
        far_trees: Option<&wgpu::Buffer>,
        far_patches_lost: u32,
    ) -> Self {
        let words = species.len() * SPECIES_WORDS.len() + FAR_WORDS.len();
        let readback = Readback::new(device, "counts of plants", bytes(words));
        for (index, arguments) in species.iter().enumerate() {
            let range = bytes(SPECIES_WORDS.start)..bytes(SPECIES_WORDS.end);
            readback.copy(encoder, arguments, range, bytes(index * SPECIES_WORDS.len()));
        }
        if let Some(state) = far_trees {
            let range = bytes(FAR_WORDS.start)..bytes(FAR_WORDS.end);
            readback.copy(encoder, state, range, bytes(species.len() * SPECIES_WORDS.len()));
        }
        Self { readback, species: species.len(), has_far_trees: far_trees.is_some(), far_patches_lost }
    }

    /// Starts the mapping, after the copies were submitted.
    #[must_use]
    pub fn start(self) -> StatsRead {
        let words = self.species * SPECIES_WORDS.len() + FAR_WORDS.len();
        let pending = self.readback.start(bytes(words));
        StatsRead { copy: self, pending }
    }
}

impl StatsRead {
    /// Whether the counts can be taken. Never blocks.
    ///
    /// # Errors
    /// The mapping failed.
    pub fn poll(&mut self, device: &wgpu::Device) -> Result<bool, ReadbackError> {
        self.pending.poll(device)
    }

    /// The counts of all species.
    ///
    /// # Errors
    /// The mapping failed or is not done.
    pub fn result(self) -> Result<CullStats, ReadbackError> {
        let copy = self.copy;
        let words: Vec<u32> = self.pending.result(bytemuck::pod_collect_to_vec)?;
        let (species, far) = words.split_at(copy.species * SPECIES_WORDS.len());
        let far = CullStats {
            blocks_lost: copy.far_patches_lost,
            clumps: if copy.has_far_trees { far[1] } else { 0 },
            clumps_lost: if copy.has_far_trees { far[FAR_LOST] } else { 0 },
            ..CullStats::default()
        };
        let counts = species.chunks_exact(SPECIES_WORDS.len());
        Ok(counts.map(CullStats::of_words).fold(far, CullStats::with))
    }
}

const fn bytes(words: usize) -> u64 {
    4 * words as u64
}
