//! The order of the passes after the HDR pass, and their targets. Passes that are off are neither
//! created nor recorded.

use super::antialias::AntialiasPass;
use super::bloom::{BloomPass, BloomTargets};
use super::exposure::{ExposurePass, exposure_buffer};
use super::resample::ResamplePass;
use super::settings::{Antialias, PostSettings};
use super::target::{Target, graded_target};
use super::tonemap::TonemapPass;
use crate::gpu::buffer::create_buffer;
use crate::gpu::targets::Targets;
use crate::gpu::timer::{GpuTimer, TimedPass};
use shaders::layout::Post;
use std::time::Duration;

/// Time in which the exposure covers 63 % of the way to the metered one, seconds.
const ADAPTATION_S: f32 = 0.7;

/// Input of the passes for one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PostFrame {
    /// The settings.
    pub settings: PostSettings,
    /// The user's exposure, stops: the metering leaves it as it is.
    pub exposure_ev: f32,
}

impl PostFrame {
    /// The frame of `settings`. Flat colours of debug views (`is_light` false) are neither metered
    /// nor spread.
    #[must_use]
    pub fn new(settings: PostSettings, exposure_ev: f32, is_light: bool) -> Self {
        let settings = settings.sanitized();
        if is_light {
            return Self { settings, exposure_ev };
        }
        Self { settings: PostSettings { auto_exposure: false, bloom: 0.0, ..settings }, exposure_ev }
    }

    fn layout(&self, rendered: (u32, u32), output: (u32, u32), adaptation: f32) -> Post {
        let settings = &self.settings;
        let ratio = |rendered: u32, output: u32| rendered as f32 / output.max(1) as f32;
        Post {
            tone: settings.tone as u32,
            auto_exposure: settings.auto_exposure.into(),
            bloom: settings.bloom,
            sharpen: settings.sharpen,
            meter: (-self.exposure_ev).exp2(),
            adaptation,
            scale: [ratio(rendered.0, output.0), ratio(rendered.1, output.1)],
        }
    }
}

/// The passes after the HDR pass.
#[derive(Debug)]
pub struct PostPasses {
    format: wgpu::TextureFormat,
    uniforms: wgpu::Buffer,
    exposure_state: wgpu::Buffer,
    sampler: wgpu::Sampler,
    tonemap: TonemapPass,
    exposure: Option<ExposurePass>,
    bloom: Option<BloomPass>,
    antialias: Option<AntialiasPass>,
    resample: Option<ResamplePass>,
    sized: OfSize,
    /// Time since the last frame.
    step: Option<Duration>,
}

/// Targets and bindings of one rendered size, made when they are first needed.
#[derive(Debug, Default)]
struct OfSize {
    exposure: Option<wgpu::BindGroup>,
    bloom: Option<BloomTargets>,
    /// Without and with bloom.
    tonemap: [Option<wgpu::BindGroup>; 2],
    /// Output of the tone curve.
    graded: Option<wgpu::TextureView>,
    antialias: Option<wgpu::BindGroup>,
    smooth: Option<wgpu::TextureView>,
    /// Over the output of the tone curve, and over that of the antialiasing.
    resample: [Option<wgpu::BindGroup>; 2],
}

impl PostPasses {
    /// The passes to images of `format`, which must not be sRGB: the shaders encode.
    #[must_use]
    pub fn new(device: &wgpu::Device, format: wgpu::TextureFormat) -> Self {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        Self {
            format,
            uniforms: create_buffer(device, "post", size_of::<Post>() as u64, usage),
            exposure_state: exposure_buffer(device),
            sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("post"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            tonemap: TonemapPass::new(device, format),
            exposure: None,
            bloom: None,
            antialias: None,
            resample: None,
            sized: OfSize::default(),
            step: None,
        }
    }

    /// The targets were replaced.
    pub fn retarget(&mut self) {
        self.sized = OfSize::default();
    }

    /// The next frame is so much later than the one before, and its exposure goes a part of the way
    /// to the metered one. Without this it is the metered one at once.
    pub fn advance(&mut self, step: Duration) {
        self.step = Some(step);
    }

    /// The metered exposure: `shaders::layout::Exposure`. For checks.
    #[must_use]
    pub fn exposure_state(&self) -> &wgpu::Buffer {
        &self.exposure_state
    }

    /// Records the passes from `targets` to `image` of `size` pixels.
    #[expect(clippy::too_many_arguments, reason = "called once, with all that a frame is made of")]
    pub fn record(
        &mut self,
        (device, queue): (&wgpu::Device, &wgpu::Queue),
        encoder: &mut wgpu::CommandEncoder,
        timer: Option<&GpuTimer>,
        frame: (&PostFrame, &wgpu::Buffer),
        targets: &Targets,
        image: &wgpu::TextureView,
        size: (u32, u32),
    ) {
        let (PostFrame { settings, .. }, uniforms) = frame;
        let step = self.step.take();
        let adaptation = step.map_or(1.0, |step| 1.0 - (-step.as_secs_f32() / ADAPTATION_S).exp());
        let post = frame.0.layout(targets.size, size, adaptation);
        queue.write_buffer(&self.uniforms, 0, bytemuck::bytes_of(&post));
        let (hdr, sampler, sized) = (targets.hdr(), &self.sampler, &mut self.sized);
        let buffers = [uniforms, &self.uniforms, &self.exposure_state];

        if settings.auto_exposure {
            let pass = self.exposure.get_or_insert_with(|| ExposurePass::new(device));
            let bindings = sized.exposure.get_or_insert_with(|| pass.bind(device, buffers, hdr));
            pass.record(encoder, bindings);
        }
        if settings.bloom > 0.0 {
            let pass = self.bloom.get_or_insert_with(|| BloomPass::new(device));
            let targets = sized.bloom.get_or_insert_with(|| pass.targets(device, targets.size, hdr, sampler));
            pass.record(encoder, targets);
        }

        let is_smoothed = settings.antialias == Antialias::Fxaa;
        let is_resampled = settings.sharpen > 0.0 || targets.size != size;
        let mut draw = |label, pipeline: &wgpu::RenderPipeline, bindings: &wgpu::BindGroup, view, ends| {
            let times = timer.map(|timer| timer.part(TimedPass::Tonemap, label == FIRST, ends));
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some(label),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                timestamp_writes: times.flatten(),
                ..Default::default()
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, bindings, &[]);
            pass.draw(0..3, 0..1);
        };

        // The HDR colour stands in for bloom that is not read.
        let bloom = sized.bloom.as_ref().filter(|_| settings.bloom > 0.0);
        let views = [hdr, bloom.map_or(hdr, BloomTargets::result)];
        let bindings = sized.tonemap[usize::from(bloom.is_some())]
            .get_or_insert_with(|| self.tonemap.bind(device, buffers, views, sampler));
        if !is_smoothed && !is_resampled {
            draw(FIRST, self.tonemap.pipeline(Target::Image), bindings, image, true);
            return;
        }
        let graded = sized.graded.get_or_insert_with(|| graded_target(device, targets.size));
        draw(FIRST, self.tonemap.pipeline(Target::Graded), bindings, graded, false);
        let mut colors = &*graded;
        if is_smoothed {
            let pass = self.antialias.get_or_insert_with(|| AntialiasPass::new(device, self.format));
            let bindings = sized.antialias.get_or_insert_with(|| pass.bind(device, graded, sampler));
            if !is_resampled {
                draw("antialias", pass.pipeline(Target::Image), bindings, image, true);
                return;
            }
            let smooth = sized.smooth.get_or_insert_with(|| graded_target(device, targets.size));
            draw("antialias", pass.pipeline(Target::Graded), bindings, smooth, false);
            colors = smooth;
        }
        let pass = self.resample.get_or_insert_with(|| ResamplePass::new(device, self.format));
        let bindings = sized.resample[usize::from(is_smoothed)]
            .get_or_insert_with(|| pass.bind(device, &self.uniforms, colors, sampler));
        let is_enlarged = settings.sharpen <= 0.0 && targets.size.0 <= size.0 && targets.size.1 <= size.1;
        draw("resample", pass.pipeline(is_enlarged), bindings, image, true);
    }
}

/// Label of the first of the timed passes.
const FIRST: &str = "tonemap";
