//! The renderer: from [`FrameData`] to an image.
//!
//! Owns pipelines, targets, the chunk pool and the shadow schedule. Knows nothing of windows,
//! sessions or time: it records commands into a view of the caller.

pub mod scenes;
pub mod tonemap;

use crate::cache::Resident;
use crate::features::atmosphere::{AtmospherePass, BackgroundPass};
use crate::features::materials::{CustomMaterials, Materials};
use crate::features::terrain::{ChunkPool, TerrainPass};
use crate::features::terrain_shadow::{Quota, Schedule, TerrainShadowPass, pass};
use crate::features::vegetation::renderer::VegetationRenderer;
use crate::features::water::{WaterPass, WaveMap};
use crate::frame::{Background, FrameData};
use crate::gpu::buffer::create_buffer;
use crate::gpu::targets::{self, Targets};
use crate::gpu::timer::{GpuTimer, TimedPass};
use crate::gpu::{Gpu, GpuError, OffscreenTarget, PassTimes, offscreen};
use crate::renderer::scenes::LocalScene;
use crate::renderer::tonemap::TonemapPass;
use crate::scene::Scene;
use crate::scene::objects::Object;
use crate::settings::{Shadows, Show};
use glam::Vec3;
use shaders::layout::Frame;

/// Options of a renderer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RenderOptions {
    /// The scene.
    pub scene: Scene,
    /// Image size, pixels.
    pub size: (u32, u32),
    /// Samples per pixel: 1 or 4, as guaranteed by WebGPU.
    pub samples: u32,
    /// Format of the images; not sRGB, the shader encodes.
    pub format: wgpu::TextureFormat,
    /// Slots of the pool, see [`ChunkPool::slots_within`].
    pub slots: u32,
}

/// The renderer.
#[derive(Debug)]
pub struct Renderer {
    samples: u32,
    uniforms: wgpu::Buffer,
    pool: ChunkPool,
    shadows: Schedule,
    shadow_pass: TerrainShadowPass,
    targets: Targets,
    materials: Materials,
    atmosphere: AtmospherePass,
    terrain: TerrainPass,
    /// Vegetation, from the first frame with plants on.
    vegetation: Option<VegetationRenderer>,
    sky: BackgroundPass,
    water: WaterPass,
    /// Local scene, drawn instead of land, sky and sea.
    local: Option<LocalScene>,
    tonemap: TonemapPass,
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
        let waves = WaveMap::bake(device, &gpu.queue);
        let software = gpu.adapter.get_info().device_type == wgpu::DeviceType::Cpu;
        let custom = scenes::materials(options.scene, custom);
        let materials = Materials::new(device, &gpu.queue, &custom, software);
        Self {
            samples,
            atmosphere: AtmospherePass::new(device, &uniforms),
            shadows: Schedule::new(options.slots),
            shadow_pass: TerrainShadowPass::new(device, &pool, options.slots),
            terrain: TerrainPass::new(device, &uniforms, &pool, &materials, options.slots, samples),
            vegetation: None,
            sky: BackgroundPass::sky(device, &uniforms, samples),
            water: WaterPass::sea(device, &uniforms, &waves, samples),
            local: LocalScene::new(
                options.scene,
                (device, &gpu.queue),
                &uniforms,
                &waves,
                &materials,
                samples,
            ),
            tonemap: TonemapPass::new(device, &uniforms, &targets, options.format),
            timer: GpuTimer::new(device),
            terrain_draws: 0,
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
        let is_shown = frame.uniforms.show == Show::Image as u32;
        if !is_shown || frame.uniforms.shadows == Shadows::Off as u32 {
            return 0;
        }
        self.shadows.update(&frame.candidates, Vec3::from(frame.uniforms.sun));
        let quota = Quota { chunks: quota.chunks.min(pass::MAX_SHADOW_CHUNKS), ..quota };
        if let Some(batch) = self.shadows.next(&frame.candidates, quota) {
            self.shadow_pass.record(&gpu.queue, &batch, encoder);
        }
        self.shadows.pending(&frame.candidates)
    }

    /// Traces all missing shadows of visible chunks, and waits for them.
    ///
    /// # Errors
    /// The device failed.
    pub fn finish_shadows(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<(), GpuError> {
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

    /// Changes the image size.
    pub fn resize(&mut self, gpu: &Gpu, size: (u32, u32)) {
        if size != self.targets.size {
            self.targets = Targets::new(&gpu.device, size, self.samples);
            self.tonemap.retarget(&gpu.device, &self.uniforms, &self.targets);
        }
    }

    /// Draws a frame and returns its linear HDR color, row by row from the top: RGBA as half
    /// floats. For checks before the tone curve. Blocks until it is drawn; none with several
    /// samples per pixel.
    ///
    /// # Errors
    /// The device fails.
    pub fn read_hdr(
        &mut self,
        gpu: &Gpu,
        frame: &FrameData,
        target: &OffscreenTarget,
    ) -> Result<Option<Vec<u16>>, GpuError> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.draw(gpu, frame, &mut encoder, &target.view);
        gpu.queue.submit([encoder.finish()]);
        if self.targets.resolved.is_some() {
            return Ok(None);
        }
        let bytes = offscreen::read_texture(gpu, self.targets.hdr_target.texture(), 8)?;
        Ok(Some(bytes.chunks_exact(2).map(|half| u16::from_le_bytes([half[0], half[1]])).collect()))
    }

    /// Records the vegetation culling, with which every frame begins; separate for measurements.
    pub fn cull_vegetation(&mut self, gpu: &Gpu, frame: &FrameData, encoder: &mut wgpu::CommandEncoder) {
        if let Some(plants) = &frame.plants {
            let vegetation = self.vegetation.get_or_insert_with(|| VegetationRenderer::new(&gpu.device));
            vegetation.cull(gpu, &self.uniforms, &self.pool, self.samples, plants, encoder);
        }
    }

    /// Draws the ids of the plants that were last culled, behind the frame's land, and returns
    /// those of each pixel, row by row from the top; zeros where no plant is visible. For checks;
    /// blocks until it is drawn. None with several samples per pixel.
    ///
    /// # Errors
    /// The device fails.
    pub fn read_ids(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<Option<Vec<[u32; 2]>>, GpuError> {
        if self.samples > 1 {
            return Ok(None);
        }
        gpu.queue.write_buffer(&self.uniforms, 0, bytemuck::bytes_of(&frame.uniforms));
        self.terrain.prepare(&gpu.queue, &frame.instances);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let depth = |load, store| {
            let ops = Some(wgpu::Operations { load, store });
            let view = &self.targets.depth;
            Some(wgpu::RenderPassDepthStencilAttachment { view, depth_ops: ops, stencil_ops: None })
        };
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("land before ids"),
                depth_stencil_attachment: depth(wgpu::LoadOp::Clear(0.0), wgpu::StoreOp::Store),
                ..Default::default()
            });
            self.terrain.draw_depth(&gpu.device, &mut pass, &self.materials);
        }
        let ids = targets::id_buffer(&gpu.device, self.targets.size);
        if let Some(vegetation) = self.vegetation.as_mut().filter(|_| frame.plants.is_some()) {
            let view = ids.create_view(&wgpu::TextureViewDescriptor::default());
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("ids"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: depth(wgpu::LoadOp::Load, wgpu::StoreOp::Discard),
                ..Default::default()
            });
            vegetation.draw_ids(gpu, &mut pass);
        }
        gpu.queue.submit([encoder.finish()]);
        let bytes = offscreen::read_texture(gpu, &ids, 8)?;
        let word = |four: &[u8]| u32::from_le_bytes([four[0], four[1], four[2], four[3]]);
        Ok(Some(bytes.chunks_exact(8).map(|pixel| [word(&pixel[..4]), word(&pixel[4..])]).collect()))
    }

    /// Records one frame into `encoder`, with the image in `output`.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        frame: &FrameData,
        encoder: &mut wgpu::CommandEncoder,
        output: &wgpu::TextureView,
    ) {
        gpu.queue.write_buffer(&self.uniforms, 0, bytemuck::bytes_of(&frame.uniforms));
        self.terrain.prepare(&gpu.queue, &frame.instances);
        if let Some(scene) = &mut self.local {
            scene.prepare(gpu, frame);
        }
        if let Some(timer) = &self.timer {
            timer.begin(encoder);
        }
        self.atmosphere.integrate(encoder, &self.uniforms);
        // Debug views and an eye under water show no plants.
        let is_shown = frame.uniforms.show == Show::Image as u32 && frame.uniforms.eye_height_m > 0.0;
        let plants = frame.plants.as_ref().filter(|_| is_shown);
        if plants.is_some() {
            self.cull_vegetation(gpu, frame, encoder);
        }
        let clear = match frame.background {
            Background::Plain([r, g, b]) => wgpu::Color { r, g, b, a: 1.0 },
            Background::SkyAndSea | Background::Sky => wgpu::Color::BLACK,
        };
        {
            // Multisampled color is resolved and discarded; a single-sample target is read by the
            // tonemap pass.
            let store =
                if self.targets.resolved.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("hdr"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &self.targets.hdr_target,
                    depth_slice: None,
                    resolve_target: self.targets.resolved.as_ref(),
                    ops: wgpu::Operations { load: wgpu::LoadOp::Clear(clear), store },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &self.targets.depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: self.timer.as_ref().map(|timer| timer.writes(TimedPass::Hdr)),
                ..Default::default()
            });
            if let Some(scene) = &self.local {
                scene.draw(&mut pass, &self.materials, &self.sky);
            } else {
                self.terrain_draws = self.terrain.draw(&mut pass, &self.materials);
                if let Some(vegetation) = self.vegetation.as_ref().filter(|_| plants.is_some()) {
                    vegetation.draw(&mut pass);
                }
                if !matches!(frame.background, Background::Plain(_)) {
                    self.sky.draw(&mut pass);
                }
                if frame.background == Background::SkyAndSea {
                    self.water.draw(&mut pass);
                }
            }
        }
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("tonemap"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: output,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            timestamp_writes: self.timer.as_ref().map(|timer| timer.writes(TimedPass::Tonemap)),
            ..Default::default()
        });
        self.tonemap.draw(&mut pass);
        drop(pass);
        if let Some(timer) = &self.timer {
            timer.resolve(encoder);
        }
    }
}
