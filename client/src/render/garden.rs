//! Plants of a frame on the GPU: chosen, then drawn. Built when the first frame comes in which
//! something grows, so that scenes without plants pay nothing.

use crate::plants::{PlantFrame, Stand};
use crate::render::cull::{Chosen, CullPasses, Told};
use crate::render::grass::{KeptClumps, Plant, PlantPass};
use crate::render::pipeline;
use crate::render::pool::ChunkPool;
use crate::render::{Gpu, GpuError};
use shaders::layout::Field;

/// Clumps of a kind that there is room for at most in each level of detail: 77 MB. More are left
/// out, farthest first, and counted.
pub const MOST_ROOM: [u32; 3] = [1 << 17, 1 << 19, 1 << 22];

/// The plants.
#[derive(Debug)]
pub struct Garden {
    passes: CullPasses,
    beds: Vec<Bed>,
    /// Frames since the start, from 1 on: what blocks are remembered by.
    frame: u32,
}

/// Passes and buffers of one kind.
#[derive(Debug)]
struct Bed {
    plant: Plant,
    pass: PlantPass,
    /// Draws names; built when a check first asks.
    names: Option<PlantPass>,
    soil: Soil,
}

/// What has to be made anew when more clumps are to fit. Pipelines are not: they take seconds to
/// compile on some drivers.
#[derive(Debug)]
struct Soil {
    chosen: Chosen,
    kept: KeptClumps,
    bindings: wgpu::BindGroup,
}

impl Garden {
    /// A garden without beds.
    #[must_use]
    pub fn new(device: &wgpu::Device) -> Self {
        Self { passes: CullPasses::new(device), beds: Vec::new(), frame: 0 }
    }

    /// Records the choice of a frame's plants, to be submitted before or with their drawing.
    pub fn choose(
        &mut self,
        gpu: &Gpu,
        uniforms: &wgpu::Buffer,
        pool: &ChunkPool,
        samples: u32,
        plants: &PlantFrame,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        self.frame = self.frame.wrapping_add(1).max(1);
        self.passes.prepare(&gpu.queue, &plants.square);
        for stand in &plants.stands {
            let plant = if stand.field.kind == Plant::Grass.kind() { Plant::Grass } else { Plant::Tree };
            let needed = room_for(stand);
            let soil = |pass: &PlantPass, room| {
                Soil::new(&gpu.device, &self.passes, uniforms, pool, (plant, pass), room)
            };
            if let Some(bed) = self.beds.iter_mut().find(|bed| bed.plant == plant) {
                let had = bed.soil.chosen.room;
                let room = std::array::from_fn(|level| needed[level].max(had[level]));
                if room != had {
                    bed.soil = soil(&bed.pass, room);
                }
            } else {
                let pass = PlantPass::new(&gpu.device, plant, pipeline::LIGHT, samples);
                let soil = soil(&pass, needed);
                self.beds.push(Bed { plant, pass, names: None, soil });
            }
        }
        for bed in &self.beds {
            let index = plants.stands.iter().position(|stand| stand.field.kind == bed.plant.kind());
            let index = index.unwrap_or(plants.stands.len());
            if let Some(stand) = plants.stands.get(index) {
                gpu.queue.write_buffer(&bed.soil.kept.field, 0, bytemuck::bytes_of(&stand.field));
            }
            self.passes.record(&gpu.queue, plants, index, self.frame, &bed.soil.chosen, encoder);
        }
    }

    /// Draws what was chosen.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>) {
        for bed in &self.beds {
            bed.pass.draw(pass, &bed.soil.bindings, &bed.soil.kept);
        }
    }

    /// Draws the names of what was chosen, one sample per pixel; for checks.
    pub fn draw_names(&mut self, gpu: &Gpu, pass: &mut wgpu::RenderPass<'_>) {
        for Bed { plant, names, soil, .. } in &mut self.beds {
            let names = names.get_or_insert_with(|| PlantPass::new(&gpu.device, *plant, pipeline::NAMES, 1));
            names.draw(pass, &soil.bindings, &soil.kept);
        }
    }

    /// What the last submitted choice came to, of all kinds together. Waits for the GPU.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn told(&self, gpu: &Gpu) -> Result<Told, GpuError> {
        self.beds.iter().try_fold(Told::default(), |told, bed| Ok(told.with(bed.soil.chosen.told(gpu)?)))
    }

    /// The buffers of each kind, for checks.
    pub fn kept(&self) -> impl Iterator<Item = (&KeptClumps, &Chosen)> {
        self.beds.iter().map(|bed| (&bed.soil.kept, &bed.soil.chosen))
    }
}

impl Soil {
    fn new(
        device: &wgpu::Device,
        passes: &CullPasses,
        uniforms: &wgpu::Buffer,
        pool: &ChunkPool,
        (plant, pass): (Plant, &PlantPass),
        room: [u32; 3],
    ) -> Self {
        let mut vertices = [0; 3];
        for (own, given) in vertices.iter_mut().zip(plant.vertices()) {
            *own = *given;
        }
        let chosen = passes.room_for(device, pool, room, vertices);
        let field = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("field"),
            size: size_of::<Field>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let kept = chosen.kept(plant, field, passes);
        let bindings = pass.bind(device, uniforms, pool, &kept);
        Self { chosen, kept, bindings }
    }
}

/// Clumps of a stand that may stand in each level of detail, all around the eye: its densest
/// everywhere, a tenth more, and no more than [`MOST_ROOM`].
fn room_for(stand: &Stand) -> [u32; 3] {
    let field = &stand.field;
    let cell_m = f64::from(1u32 << stand.planting.cell_bits) / 4096.0;
    let per_m2 = f64::from(stand.planting.per_cell) / (cell_m * cell_m);
    let (thin, range) = (f64::from(field.thin_from_m), f64::from(field.range_m));
    // Clumps within a distance: all up to `thin`, beyond it a share that falls with the distance,
    // and those that are narrowing before they are left out: an eighth more, and one rank of 256.
    let within = |distance: f64| {
        let distance = distance.min(range);
        let near = distance.min(thin);
        let far = (distance - thin).max(0.0);
        let ring = distance * distance - near * near;
        per_m2 * std::f64::consts::PI * (near * near + 1.125 * 2.0 * thin * far + ring / 256.0)
    };
    let ends = [f64::from(field.lod_m[0]), f64::from(field.lod_m[1]), range];
    let begins = [0.0, ends[0], ends[1]];
    std::array::from_fn(|level| {
        let needed = 1.1 * (within(ends[level]) - within(begins[level])).max(0.0) + 1024.0;
        (needed as u32).min(MOST_ROOM[level])
    })
}
