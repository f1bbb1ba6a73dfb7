//! The renderer: from [`FrameData`] to an image.
//!
//! Owns pipelines, targets, the chunk pool and the shadow schedule. Knows nothing of windows,
//! sessions or time: it records commands into a view of the caller.

mod inspection;
pub mod scenes;

use crate::cache::Resident;
use crate::features::atmosphere::{AtmospherePass, SkyPass};
use crate::features::materials::{CustomMaterials, Materials};
use crate::features::post::PostPasses;
use crate::features::terrain::{ChunkPool, TerrainPass};
use crate::features::terrain_clipmap::textures::ALL_TILES;
use crate::features::terrain_clipmap::{ClipmapSize, TerrainClipmap};
use crate::features::terrain_shadow::{Quota, Schedule, TerrainShadowPass, pass};
use crate::features::vegetation::renderer::VegetationRenderer;
use crate::features::vegetation::tree_cells::TreeCells;
use crate::features::water::{WaterPass, WaveMap};
use crate::frame::{Background, FrameData};
use crate::gpu::buffer::create_buffer;
use crate::gpu::targets::Targets;
use crate::gpu::timer::{GpuTimer, TimedPass};
use crate::gpu::{Gpu, GpuError, PassTimes};
use crate::renderer::scenes::LocalScene;
use crate::scene::Scene;
use crate::scene::objects::Object;
use crate::settings::{Shadows, Show};
use glam::Vec3;
use shaders::layout::Frame;
use std::time::Duration;
use terrain::lod::MAX_VIEW_DISTANCE_M;

/// Options of a renderer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RenderOptions {
    /// The scene.
    pub scene: Scene,
    /// Image size, pixels.
    pub size: (u32, u32),
    /// Samples per pixel: 1 or 4, as guaranteed by WebGPU.
    pub samples: u32,
    /// Anisotropy of the filter of materials, see [`Materials::new`].
    pub anisotropy: u16,
    /// Format of the images; not sRGB, the shader encodes.
    pub format: wgpu::TextureFormat,
    /// Slots of the pool, see [`ChunkPool::slots_within`].
    pub slots: u32,
    /// Texels along a side of each level of the terrain clipmap.
    pub clipmap_texels: u32,
}

/// The renderer.
#[derive(Debug)]
pub struct Renderer {
    samples: u32,
    /// Size of the images, pixels; the targets have the rendered size.
    size: (u32, u32),
    uniforms: wgpu::Buffer,
    pool: ChunkPool,
    shadows: Schedule,
    shadow_pass: TerrainShadowPass,
    targets: Targets,
    materials: Materials,
    atmosphere: AtmospherePass,
    clipmap: TerrainClipmap,
    terrain: TerrainPass,
    trees: TreeCells,
    /// Vegetation, from the first frame with plants on.
    vegetation: Option<VegetationRenderer>,
    sky: SkyPass,
    water: WaterPass,
    /// Local scene, drawn instead of land, sky and sea.
    local: Option<LocalScene>,
    post: PostPasses,
    timer: Option<GpuTimer>,
    terrain_draws: u32,
}

impl Renderer {
    /// Creates pipelines, pool and targets, and bakes the materials.
    #[must_use]
    pub fn new(gpu: &Gpu, options: &RenderOptions) -> Self {
        Self::with_materials(gpu, options, &CustomMaterials::default())
    }

    /// [`Renderer::new`] with custom materials.
    #[must_use]
    pub fn with_materials(gpu: &Gpu, options: &RenderOptions, custom: &CustomMaterials) -> Self {
        let (device, samples) = (&gpu.device, options.samples);
        let uniforms = create_buffer(
            device,
            "frame",
            size_of::<Frame>() as u64,
            wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        );
        let pool = ChunkPool::new(device, options.slots);
        let targets = Targets::new(device, options.size, samples);
        let trees = TreeCells::new(device);
        let waves = WaveMap::bake(device, &gpu.queue);
        let custom = scenes::materials(options.scene, custom);
        let materials = Materials::new(device, &gpu.queue, &custom, options.anisotropy);
        let clipmap =
            TerrainClipmap::new(device, ClipmapSize::new(options.clipmap_texels, MAX_VIEW_DISTANCE_M));
        let land_layouts = [materials.layout(), clipmap.layout()];
        Self {
            samples,
            atmosphere: AtmospherePass::new(device, &uniforms),
            shadows: Schedule::new(options.slots),
            shadow_pass: TerrainShadowPass::new(device, &pool, options.slots),
            terrain: TerrainPass::new(
                device,
                &uniforms,
                &pool,
                (trees.cells(), trees.marks()),
                land_layouts,
                options.slots,
                samples,
            ),
            trees,
            vegetation: None,
            sky: SkyPass::new(device, &uniforms, samples),
            water: WaterPass::sea(device, &uniforms, &waves, samples),
            local: LocalScene::new(options.scene, device, &uniforms, &waves, &materials, samples),
            post: PostPasses::new(device, options.format),
            size: options.size,
            timer: GpuTimer::new(device),
            terrain_draws: 0,
            clipmap,
            materials,
            uniforms,
            pool,
            targets,
        }
    }

    /// GPU data of the resident chunks.
    #[must_use]
    pub fn pool(&self) -> &ChunkPool {
        &self.pool
    }

    /// Draw calls of the land in the last frame.
    #[must_use]
    pub fn terrain_draws(&self) -> u32 {
        self.terrain_draws
    }

    /// GPU bytes of one more chunk: the buffers that grow with the number of slots, by their real
    /// sizes.
    #[must_use]
    pub fn bytes_per_chunk(&self) -> u64 {
        (self.pool.bytes() + self.terrain.bytes() + self.shadow_pass.bytes())
            .div_ceil(u64::from(self.pool.slots()))
    }

    /// GPU times of the passes of the last submitted frame; none without timestamp queries.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn pass_times(&self, gpu: &Gpu) -> Result<Option<PassTimes>, GpuError> {
        self.timer.as_ref().map(|timer| timer.read(gpu)).transpose()
    }

    /// Replaces the objects of a parallax scene; no effect in other scenes. For measurements.
    pub fn set_objects(&mut self, gpu: &Gpu, objects: Vec<Object>) {
        if let Some(LocalScene::Pom(scene)) = &mut self.local {
            scene.set_objects(&gpu.device, objects);
        }
    }

    /// The vegetation, from the first frame with plants on.
    #[must_use]
    pub fn vegetation(&self) -> Option<&VegetationRenderer> {
        self.vegetation.as_ref()
    }

    /// Uploads a chunk to its slot.
    pub fn upload(&mut self, gpu: &Gpu, chunk: &Resident) {
        self.pool.upload(&gpu.queue, chunk);
        self.shadows.forget(chunk.slot);
    }

    /// Records traces of missing shadows, as many as `quota` (and [`MAX_SHADOW_CHUNKS`]) allows, to
    /// be submitted before or with the frame and before the next call. Returns how many visible
    /// chunks are left: 0 when all shadows are current. Chunks that were never traced are drawn
    /// fully lit.
    ///
    /// [`MAX_SHADOW_CHUNKS`]: crate::features::terrain_shadow::pass::MAX_SHADOW_CHUNKS
    pub fn trace_shadows(
        &mut self,
        gpu: &Gpu,
        frame: &FrameData,
        quota: Quota,
        encoder: &mut wgpu::CommandEncoder,
    ) -> usize {
        let is_lit = [Show::Image, Show::Light].map(|show| show as u32).contains(&frame.uniforms.show);
        if !is_lit || frame.uniforms.shadows == Shadows::Off as u32 {
            return 0;
        }
        self.shadows.update(&frame.candidates, Vec3::from(frame.uniforms.sun));
        let quota = Quota { chunks: quota.chunks.min(pass::MAX_SHADOW_CHUNKS), ..quota };
        if let Some(batch) = self.shadows.next(&frame.candidates, quota) {
            self.shadow_pass.record(&gpu.queue, &batch, encoder);
        }
        self.shadows.pending(&frame.candidates)
    }

    /// Fills missing tiles of the terrain clipmap, at most `most`; returns how many were filled.
    /// Until a level is complete, the next coarser one is used.
    pub fn fill_clipmap(&mut self, gpu: &Gpu, frame: &FrameData, most: usize) -> usize {
        let view_distance_m = frame.uniforms.view_distance_m as u32;
        self.clipmap.update(&gpu.queue, &frame.eye, frame.clipmap.as_ref(), view_distance_m, most)
    }

    /// Bakes what the frame needs, fills the terrain clipmap, traces all missing shadows of visible
    /// chunks, and waits for them.
    ///
    /// # Errors
    /// The device failed.
    pub fn finish_shading(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<(), GpuError> {
        self.finish_bake(gpu, frame)?;
        self.fill_clipmap(gpu, frame, ALL_TILES);
        loop {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            let pending = self.trace_shadows(gpu, frame, pass::ALL_VISIBLE, &mut encoder);
            gpu.queue.submit([encoder.finish()]);
            // One at a time: several long dispatches in one queue make some drivers lose the
            // device.
            gpu.wait()?;
            if pending == 0 {
                return Ok(());
            }
        }
    }

    /// Bakes what the frame needs, and waits for it.
    fn finish_bake(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<(), GpuError> {
        if let Some(scene) = &mut self.local {
            while !scene.bake(gpu, frame)? {
                gpu.wait()?;
            }
        }
        Ok(())
    }

    /// Changes the image size.
    pub fn resize(&mut self, size: (u32, u32)) {
        self.size = size;
    }

    /// The next frame is so much later than the one before: an automatic exposure adapts over this
    /// time. Without this it adapts at once.
    pub fn advance(&mut self, step: Duration) {
        self.post.advance(step);
    }

    /// The passes after the HDR pass.
    #[must_use]
    pub fn post(&self) -> &PostPasses {
        &self.post
    }

    /// Replaces the targets if a frame needs another size.
    fn retarget(&mut self, gpu: &Gpu, frame: &FrameData) {
        let (width, height) = frame.post.settings.rendered_size(self.size);
        let size = (width.max(1), height.max(1));
        if size != self.targets.size {
            self.targets = Targets::new(&gpu.device, size, self.samples);
            self.post.retarget();
        }
    }

    fn cull(&mut self, gpu: &Gpu, frame: &FrameData, encoder: &mut wgpu::CommandEncoder) {
        if let Some(plants) = &frame.plants {
            let vegetation = self.vegetation.get_or_insert_with(|| VegetationRenderer::new(&gpu.device));
            vegetation.cull(gpu, &self.uniforms, (&self.pool, &self.trees), self.samples, plants, encoder);
        }
    }

    /// Records one frame into `encoder`, with the image in `output`.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        frame: &FrameData,
        encoder: &mut wgpu::CommandEncoder,
        output: &wgpu::TextureView,
    ) {
        self.retarget(gpu, frame);
        gpu.queue.write_buffer(&self.uniforms, 0, bytemuck::bytes_of(&frame.uniforms));
        self.terrain.prepare(&gpu.queue, &frame.instances);
        if let Some(scene) = &mut self.local {
            scene.prepare(gpu, frame);
        }
        if let Some(timer) = &self.timer {
            timer.begin(encoder);
        }
        self.atmosphere.integrate(encoder, &self.uniforms);
        let is_picture = frame.uniforms.show == Show::Image as u32;
        let is_under_water = frame.uniforms.eye_height_m <= 0.0;
        if frame.plants.is_some() {
            self.cull(gpu, frame, encoder);
        } else {
            self.trees.clear(encoder);
        }
        let plants = frame.plants.as_ref();
        let clear = match frame.background {
            Background::Plain([r, g, b]) => wgpu::Color { r, g, b, a: 1.0 },
            Background::SkyAndSea | Background::Sky => wgpu::Color::BLACK,
        };
        {
            let times = self.timer.as_ref().map(|timer| timer.writes(TimedPass::Hdr));
            let mut pass = self.targets.begin_hdr(encoder, clear, times);
            if let Some(scene) = &self.local {
                scene.draw(&mut pass, &self.materials, &self.sky);
            } else {
                let vegetation = self.vegetation.as_ref().filter(|_| plants.is_some());
                if let Some(vegetation) = vegetation {
                    vegetation.draw_grass(&mut pass);
                }
                let (materials, clipmap) = (&self.materials, &self.clipmap);
                self.terrain_draws = if is_picture {
                    self.terrain.draw(&mut pass, materials, clipmap)
                } else {
                    self.terrain.draw_inspected(&gpu.device, &mut pass, materials, clipmap)
                };
                if let Some(vegetation) = vegetation {
                    vegetation.draw_trees(&mut pass);
                }
                let has_sea = frame.background == Background::SkyAndSea;
                // Under water the sea covers all that the land does not.
                let is_covered = has_sea && is_under_water;
                if !matches!(frame.background, Background::Plain(_)) && !is_covered {
                    self.sky.draw(&mut pass);
                }
                if has_sea {
                    self.water.draw(&mut pass, is_under_water);
                }
            }
        }
        self.post.record(
            (&gpu.device, &gpu.queue),
            encoder,
            self.timer.as_ref(),
            (&frame.post, &self.uniforms),
            &self.targets,
            output,
            (self.size.0.max(1), self.size.1.max(1)),
        );
        if let Some(timer) = &self.timer {
            timer.resolve(encoder);
        }
    }
}
