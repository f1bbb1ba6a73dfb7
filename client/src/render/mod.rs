//! The renderer: everything between a [`FrameData`] and a picture.
//!
//! Owns pipelines, targets, the pool of chunks and the state of their shadows. Knows nothing of
//! windows, sessions or time: a frame goes in, commands come out, into whatever view the caller
//! gives.

pub mod air;
pub mod backdrop;
pub mod cast;
pub mod clock;
pub mod cones;
pub mod cull;
pub mod fill;
pub mod garden;
pub mod gpu;
pub mod grass;
pub mod materials;
pub mod mesh;
pub mod picture;
pub mod pipeline;
pub mod pool;
pub mod relief;
pub mod scenes;
pub mod surface;
pub mod targets;
pub mod terrain;
pub mod tiling_probe;
pub mod tone;
pub mod water;
pub mod waves;

pub use clock::PassTimes;
pub use gpu::{Gpu, GpuError};
pub use picture::{Canvas, Picture};

use crate::frame::{Backdrop, FrameData};
use crate::looks::{Shadows, Show};
use crate::scene::Scene;
use crate::shadow::{Quota, Schedule};
use crate::world::Resident;
use air::AirPass;
use backdrop::BackdropPass;
use cast::CastPass;
use clock::{PassClock, TimedPass};
use garden::Garden;
use glam::Vec3;
use materials::{Materials, OwnMaterials};
use pool::ChunkPool;
use scenes::LocalScene;
use scenes::relief::objects::Object;
use shaders::layout::Frame;
use targets::Targets;
use terrain::TerrainPass;
use tone::TonePass;
use water::WaterPass;
use waves::WaveMap;

/// What a renderer is built for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RenderOptions {
    /// What is drawn.
    pub scene: Scene,
    /// Picture size, pixels.
    pub size: (u32, u32),
    /// Samples per pixel: 1 or 4, the two that WebGPU promises.
    pub samples: u32,
    /// Format of the pictures; must not encode sRGB by itself.
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
    cast: CastPass,
    targets: Targets,
    materials: Materials,
    air: AirPass,
    terrain: TerrainPass,
    /// What grows on the land, once anything has.
    garden: Option<Garden>,
    sky: BackdropPass,
    water: WaterPass,
    /// Drawn instead of land, sky and sea.
    local: Option<LocalScene>,
    tone: TonePass,
    clock: Option<PassClock>,
    terrain_draws: u32,
}

impl Renderer {
    /// Builds pipelines, pool and targets, and bakes the materials.
    #[must_use]
    pub fn new(gpu: &Gpu, options: &RenderOptions) -> Self {
        Self::with_materials(gpu, options, &OwnMaterials::default())
    }

    /// The same with a user's materials.
    #[must_use]
    pub fn with_materials(gpu: &Gpu, options: &RenderOptions, own: &OwnMaterials) -> Self {
        let (device, samples) = (&gpu.device, options.samples);
        let uniforms = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<Frame>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let pool = ChunkPool::new(device, options.slots);
        let targets = Targets::new(device, options.size, samples);
        let waves = WaveMap::bake(device, &gpu.queue);
        let software = gpu.adapter.get_info().device_type == wgpu::DeviceType::Cpu;
        let own = scenes::materials(options.scene, own);
        let materials = Materials::new(device, &gpu.queue, &own, software);
        Self {
            samples,
            air: AirPass::new(device, &uniforms),
            shadows: Schedule::new(options.slots),
            cast: CastPass::new(device, &pool, options.slots),
            terrain: TerrainPass::new(device, &uniforms, &pool, &materials, options.slots, samples),
            garden: None,
            sky: BackdropPass::sky(device, &uniforms, samples),
            water: WaterPass::sea(device, &uniforms, &waves, samples),
            local: LocalScene::new(
                options.scene,
                (device, &gpu.queue),
                &uniforms,
                &waves,
                &materials,
                samples,
            ),
            tone: TonePass::new(device, &uniforms, &targets, options.format),
            clock: PassClock::new(device),
            terrain_draws: 0,
            materials,
            uniforms,
            pool,
            targets,
        }
    }

    /// What the GPU holds of the resident chunks.
    #[must_use]
    pub fn pool(&self) -> &ChunkPool {
        &self.pool
    }

    /// Draw calls that the land of the last frame took.
    #[must_use]
    pub fn terrain_draws(&self) -> u32 {
        self.terrain_draws
    }

    /// Bytes on the GPU that one more chunk takes: the buffers that grow with the number of slots,
    /// by their real sizes.
    #[must_use]
    pub fn bytes_per_chunk(&self) -> u64 {
        (self.pool.bytes() + self.terrain.bytes() + self.cast.bytes()).div_ceil(u64::from(self.pool.slots()))
    }

    /// What the passes of the last submitted frame took by the GPU's clock; none if the device was
    /// opened without one.
    ///
    /// # Errors
    /// The GPU failed.
    pub fn pass_times(&self, gpu: &Gpu) -> Result<Option<PassTimes>, GpuError> {
        self.clock.as_ref().map(|clock| clock.read(gpu)).transpose()
    }

    /// Puts other objects into a scene of reliefs; other scenes have none. For measuring: the
    /// scene's own objects are there from the start.
    pub fn arrange(&mut self, gpu: &Gpu, objects: Vec<Object>) {
        if let Some(LocalScene::Relief(scene)) = &mut self.local {
            scene.arrange(&gpu.device, objects);
        }
    }

    /// The plants of the last frame, once anything has grown.
    #[must_use]
    pub fn garden(&self) -> Option<&Garden> {
        self.garden.as_ref()
    }

    /// Puts a chunk into its slot.
    pub fn upload(&mut self, gpu: &Gpu, chunk: &Resident) {
        self.pool.upload(&gpu.queue, chunk);
        self.shadows.forget(chunk.slot);
    }

    /// Records the finding of shadows that the frame lacks, as many as `quota` (and [`MAX_CASTS`])
    /// allows, to be submitted before or with its picture and before the next call. Returns how
    /// many chunks in sight are still left: 0 when the picture will be right. Chunks whose shadow
    /// was never found are drawn in full sun.
    ///
    /// [`MAX_CASTS`]: cast::MAX_CASTS
    pub fn cast(
        &mut self,
        gpu: &Gpu,
        frame: &FrameData,
        quota: Quota,
        encoder: &mut wgpu::CommandEncoder,
    ) -> usize {
        let is_shown = frame.uniforms.show == Show::Picture as u32;
        if !is_shown || frame.uniforms.shadows == Shadows::Off as u32 {
            return 0;
        }
        self.shadows.update(&frame.candidates, Vec3::from(frame.uniforms.sun));
        let quota = Quota { chunks: quota.chunks.min(cast::MAX_CASTS), ..quota };
        if let Some(casting) = self.shadows.next(&frame.candidates, quota) {
            self.cast.record(&gpu.queue, &casting, encoder);
        }
        self.shadows.pending(&frame.candidates)
    }

    /// Finds all shadows in sight that the frame lacks, and waits for them.
    ///
    /// # Errors
    /// The device failed.
    pub fn finish_shadows(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<(), GpuError> {
        loop {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            let pending = self.cast(gpu, frame, cast::ALL_IN_SIGHT, &mut encoder);
            gpu.queue.submit([encoder.finish()]);
            // One at a time: many long dispatches in one queue make some drivers give up on the
            // device.
            gpu.wait()?;
            if pending == 0 {
                return Ok(());
            }
        }
    }

    /// Draws pictures of another size from now on.
    pub fn resize(&mut self, gpu: &Gpu, size: (u32, u32)) {
        if size != self.targets.size {
            self.targets = Targets::new(&gpu.device, size, self.samples);
            self.tone.retarget(&gpu.device, &self.uniforms, &self.targets);
        }
    }

    /// Draws a picture and returns its linear light, row by row from the top: RGBA as half floats.
    /// For checks that look behind the tone curve. Blocks until it is drawn; nothing is returned
    /// with several samples per pixel.
    ///
    /// # Errors
    /// The device fails.
    pub fn light(
        &mut self,
        gpu: &Gpu,
        frame: &FrameData,
        canvas: &Canvas,
    ) -> Result<Option<Vec<u16>>, GpuError> {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.draw(gpu, frame, &mut encoder, &canvas.view);
        gpu.queue.submit([encoder.finish()]);
        if self.targets.resolved.is_some() {
            return Ok(None);
        }
        let bytes = picture::read_texture(gpu, self.targets.gathered.texture(), 8)?;
        Ok(Some(bytes.chunks_exact(2).map(|half| u16::from_le_bytes([half[0], half[1]])).collect()))
    }

    /// Records the choice of the frame's plants, which every picture begins with; alone for
    /// measuring.
    pub fn choose(&mut self, gpu: &Gpu, frame: &FrameData, encoder: &mut wgpu::CommandEncoder) {
        if let Some(plants) = &frame.plants {
            let garden = self.garden.get_or_insert_with(|| Garden::new(&gpu.device));
            garden.choose(gpu, &self.uniforms, &self.pool, self.samples, plants, encoder);
        }
    }

    /// Draws the plants that were last chosen by their names, with the frame's land in front of
    /// them, and returns what each pixel shows, row by row from the top: see
    /// `shaders/wgsl/shared/name.wesl`, zeros where no plant is seen. For checks; blocks until it
    /// is drawn. Nothing is returned with several samples per pixel.
    ///
    /// # Errors
    /// The device fails.
    pub fn names(&mut self, gpu: &Gpu, frame: &FrameData) -> Result<Option<Vec<[u32; 2]>>, GpuError> {
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
                label: Some("land before names"),
                depth_stencil_attachment: depth(wgpu::LoadOp::Clear(0.0), wgpu::StoreOp::Store),
                ..Default::default()
            });
            self.terrain.draw_depth(&gpu.device, &mut pass, &self.materials);
        }
        let names = targets::names(&gpu.device, self.targets.size);
        if let Some(garden) = self.garden.as_mut().filter(|_| frame.plants.is_some()) {
            let view = names.create_view(&wgpu::TextureViewDescriptor::default());
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("names"),
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
            garden.draw_names(gpu, &mut pass);
        }
        gpu.queue.submit([encoder.finish()]);
        let bytes = picture::read_texture(gpu, &names, 8)?;
        let word = |four: &[u8]| u32::from_le_bytes([four[0], four[1], four[2], four[3]]);
        Ok(Some(bytes.chunks_exact(8).map(|pixel| [word(&pixel[..4]), word(&pixel[4..])]).collect()))
    }

    /// Records one picture into `encoder`, to appear in `output`.
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
        if let Some(clock) = &self.clock {
            clock.begin(encoder);
        }
        self.air.measure(encoder, &self.uniforms);
        // Inspecting views show the land's machinery, and an eye under water sees no plants.
        let is_shown = frame.uniforms.show == Show::Picture as u32 && frame.uniforms.eye_height_m > 0.0;
        let plants = frame.plants.as_ref().filter(|_| is_shown);
        if plants.is_some() {
            self.choose(gpu, frame, encoder);
        }
        let behind = match frame.backdrop {
            Backdrop::Plain([r, g, b]) => wgpu::Color { r, g, b, a: 1.0 },
            Backdrop::SkyAndSea | Backdrop::Sky => wgpu::Color::BLACK,
        };
        {
            // Samples are gone once resolved; a single-sample target is read by the tone pass.
            let store =
                if self.targets.resolved.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("light"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &self.targets.gathered,
                    depth_slice: None,
                    resolve_target: self.targets.resolved.as_ref(),
                    ops: wgpu::Operations { load: wgpu::LoadOp::Clear(behind), store },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &self.targets.depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: self.clock.as_ref().map(|clock| clock.writes(TimedPass::Light)),
                ..Default::default()
            });
            if let Some(scene) = &self.local {
                scene.draw(&mut pass, &self.materials, &self.sky);
            } else {
                self.terrain_draws = self.terrain.draw(&mut pass, &self.materials);
                if let Some(garden) = self.garden.as_ref().filter(|_| plants.is_some()) {
                    garden.draw(&mut pass);
                }
                if !matches!(frame.backdrop, Backdrop::Plain(_)) {
                    self.sky.draw(&mut pass);
                }
                if frame.backdrop == Backdrop::SkyAndSea {
                    self.water.draw(&mut pass);
                }
            }
        }
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("tone"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: output,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            timestamp_writes: self.clock.as_ref().map(|clock| clock.writes(TimedPass::Tone)),
            ..Default::default()
        });
        self.tone.draw(&mut pass);
        drop(pass);
        if let Some(clock) = &self.clock {
            clock.collect(encoder);
        }
    }
}
