//! The passes after the HDR pass over made pictures: exposure, bloom, tone curve, antialiasing,
//! sharpening, resampling, and light that is not finite.

use client::features::post::bloom::BloomPass;
use client::features::post::{Antialias, PostFrame, PostPasses, PostSettings, Tone};
use client::gpu::buffer::create_buffer;
use client::gpu::offscreen::{IMAGE_FORMAT, read_level};
use client::gpu::readback::Readback;
use client::gpu::targets::{HDR_FORMAT, Targets};
use client::gpu::{Gpu, GpuError, OffscreenTarget};
use half::f16;
use shaders::layout::{Exposure, Frame};
use std::time::Duration;

type Size = (u32, u32);

/// A device; none, visibly, where there is no adapter and none is required.
fn device() -> Option<Gpu> {
    match Gpu::open_blocking() {
        Ok(gpu) => Some(gpu),
        Err(error @ GpuError::NoAdapter(_)) if std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none() => {
            eprintln!("SKIPPED: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// Targets whose HDR color is `light` of each pixel.
fn targets(gpu: &Gpu, size: Size, light: impl Fn(u32, u32) -> f32) -> Targets {
    let extent = wgpu::Extent3d { width: size.0, height: size.1, depth_or_array_layers: 1 };
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("made picture"),
        size: extent,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: HDR_FORMAT,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let pixels = (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y)));
    let halves: Vec<u16> = pixels
        .flat_map(|(x, y)| {
            let value = f16::from_f32(light(x, y)).to_bits();
            [value, value, value, f16::ONE.to_bits()]
        })
        .collect();
    gpu.queue.write_texture(
        texture.as_image_copy(),
        bytemuck::cast_slice(&halves),
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(8 * size.0), rows_per_image: None },
        extent,
    );
    let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
    Targets { hdr_target: view, ..Targets::new(&gpu.device, size, 1) }
}

/// The passes with the uniforms of a frame whose exposure is 1.
struct Chain {
    gpu: Gpu,
    passes: PostPasses,
    frame: wgpu::Buffer,
}

impl Chain {
    fn open() -> Option<Self> {
        let gpu = device()?;
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let frame = create_buffer(&gpu.device, "frame", size_of::<Frame>() as u64, usage);
        let uniforms = Frame { exposure: 1.0, ..bytemuck::Zeroable::zeroed() };
        gpu.queue.write_buffer(&frame, 0, bytemuck::bytes_of(&uniforms));
        let passes = PostPasses::new(&gpu.device, IMAGE_FORMAT);
        Some(Self { gpu, passes, frame })
    }

    /// The first channel of the image of `size`, row by row from the top; checks that colours are
    /// grey or magenta.
    fn image(&mut self, settings: PostSettings, targets: &Targets, size: Size) -> Vec<u8> {
        let target = OffscreenTarget::new(&self.gpu.device, size.0, size.1);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let frame = PostFrame::new(settings, 0.0, true);
        self.passes.retarget();
        self.passes.record(
            (&self.gpu.device, &self.gpu.queue),
            &mut encoder,
            None,
            (&frame, &self.frame),
            targets,
            &target.view,
            size,
        );
        self.gpu.queue.submit([encoder.finish()]);
        let image = target.read(&self.gpu).unwrap();
        let channel = |pixel: &[u8]| {
            let is_grey = pixel[0].abs_diff(pixel[1]) < 2 && pixel[0].abs_diff(pixel[2]) < 2;
            assert!(is_grey || pixel == MAGENTA, "{pixel:?}");
            if is_grey { pixel[0] } else { BROKEN }
        };
        image.rgba.chunks_exact(4).map(channel).collect()
    }

    fn exposure(&self) -> Exposure {
        let bytes = size_of::<Exposure>() as u64;
        let readback = Readback::new(&self.gpu.device, "exposure", bytes);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        readback.copy(&mut encoder, self.passes.exposure_state(), 0..bytes, 0);
        self.gpu.queue.submit([encoder.finish()]);
        self.gpu.read(&readback, bytes, bytemuck::pod_read_unaligned).unwrap()
    }

    /// The exposure after one frame of a picture, and that frame.
    fn metered(&mut self, size: Size, light: impl Fn(u32, u32) -> f32) -> (Exposure, Vec<u8>) {
        let targets = targets(&self.gpu, size, light);
        let settings = PostSettings { auto_exposure: true, ..PostSettings::default() };
        let image = self.image(settings, &targets, size);
        (self.exposure(), image)
    }
}

const MAGENTA: [u8; 4] = [255, 0, 255, 255];
/// Stands for magenta in grey pictures whose greys are below it.
const BROKEN: u8 = 255;

#[test]
fn equal_pictures_have_equal_exposures_and_the_change_is_clamped() {
    let Some(mut chain) = Chain::open() else { return };
    let noise = |x: u32, y: u32| ((x * 7919 + y * 104_729) % 1000) as f32 / 900.0 + 0.001;
    let (first, image) = chain.metered((257, 131), noise);
    let (second, again) = chain.metered((257, 131), noise);
    assert_eq!(bytemuck::bytes_of(&first), bytemuck::bytes_of(&second));
    assert!(image == again && first.ev.abs() < 1.5 && first.ev != 0.0, "{first:?}");
    // Control: twice the light has less exposure.
    assert!(chain.metered((257, 131), |x, y| 2.0 * noise(x, y)).0.ev < first.ev - 0.1);
    for size in [(64, 64), (1, 1), (1, 300), (300, 1)] {
        for (light, ev) in [(0.0, 1.5), (6e4, -1.5), (0.25, 0.0), (f32::NAN, 0.0), (-1.0, 1.5)] {
            let exposure = chain.metered(size, |_, _| light).0;
            assert!((exposure.ev - ev).abs() < 1e-3, "{size:?} {light}: {exposure:?}");
            assert!((exposure.factor - ev.exp2()).abs() < 1e-3, "{exposure:?}");
        }
    }
}

#[test]
fn the_exposure_adapts_over_time_and_at_once_without_a_step() {
    let Some(mut chain) = Chain::open() else { return };
    assert!(chain.metered((8, 8), |_, _| 6e4).0.ev < -1.49);
    let mut last = -1.5;
    for _ in 0..5 {
        chain.passes.advance(Duration::from_millis(100));
        let ev = chain.metered((8, 8), |_, _| 0.25).0.ev;
        assert!(ev > last + 0.01 && ev < -0.1, "{ev} after {last}");
        last = ev;
    }
    assert!(chain.metered((8, 8), |_, _| 0.25).0.ev.abs() < 1e-3, "at once");
}

/// Mean of a half-float texture's first channel.
fn mean(gpu: &Gpu, view: &wgpu::TextureView) -> f64 {
    let bytes = read_level(gpu, view.texture(), 0, 8).unwrap();
    let values = bytes.chunks_exact(8).map(|pixel| f16::from_le_bytes([pixel[0], pixel[1]]).to_f64());
    values.sum::<f64>() / (bytes.len() / 8) as f64
}

#[test]
fn bloom_keeps_the_light_of_a_smooth_picture_and_drops_lone_pixels() {
    let Some(gpu) = device() else { return };
    let size = (320, 180);
    let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        ..Default::default()
    });
    let spread = |light: &dyn Fn(u32, u32) -> f32| {
        let targets = targets(&gpu, size, light);
        let pass = BloomPass::new(&gpu.device);
        let bloom = pass.targets(&gpu.device, size, targets.hdr(), &sampler);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        pass.record(&mut encoder, &bloom);
        gpu.queue.submit([encoder.finish()]);
        mean(&gpu, bloom.result())
    };
    let light = |x: u32, y: u32| {
        let off = (f64::from(x) - 160.0).hypot(f64::from(y) - 90.0) / 40.0;
        (0.2 + 3.0 * (-off * off).exp()) as f32
    };
    let pixels = (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y)));
    let truth = pixels.map(|(x, y)| f64::from(light(x, y))).sum::<f64>() / f64::from(size.0 * size.1);
    let smooth = spread(&light);
    println!("bloom of a smooth picture: mean {smooth:.5} of {truth:.5}");
    assert!((smooth / truth - 1.0).abs() < 0.01, "{smooth} of {truth}");
    // Control: 2 % more light is seen.
    assert!((spread(&|x, y| 1.02 * light(x, y)) / truth - 1.0).abs() > 0.01);
    // The Karis average: a pixel that may flicker adds less than a third of its light.
    let lone = spread(&|x, y| if (x, y) == (160, 90) { 1000.0 } else { 0.0 });
    let its_mean = 1000.0 / f64::from(size.0 * size.1);
    println!("a lone pixel: {:.3} of its light", lone / its_mean);
    assert!(lone < 0.34 * its_mean, "{lone} of {its_mean}");
    // Light that is not finite does not spread.
    let broken = spread(&|x, y| if (x, y) == (160, 90) { f32::NAN } else { 0.5 });
    assert!((broken - 0.5).abs() < 1e-3, "{broken}");
}

/// White above a line that falls one pixel in 5.3.
fn is_white(x: f64, y: f64) -> bool {
    x * 0.19 + 13.3 > y
}

#[test]
fn antialiasing_and_a_larger_rendering_approach_the_supersampled_edge() {
    let Some(mut chain) = Chain::open() else { return };
    let size = (96, 48);
    let at = |scale: u32| {
        move |x: u32, y: u32| {
            let place = |at: u32| (f64::from(at) + 0.5) / f64::from(scale);
            if is_white(place(x), place(y)) { 0.6 } else { 0.05 }
        }
    };
    let single = targets(&chain.gpu, size, at(1));
    let none = PostSettings::default();
    let jagged = chain.image(none, &single, size);
    let (white, black) = (f64::from(jagged[0]), f64::from(jagged[jagged.len() - 1]));
    // 16 x 16 samples a pixel, between the same two encoded colours.
    let mut truth = Vec::new();
    for y in 0..size.1 {
        for x in 0..size.0 {
            let samples = (0..256).filter(|sample| {
                let place = |at: u32, index: i32| f64::from(at) + (f64::from(index) + 0.5) / 16.0;
                is_white(place(x, sample % 16), place(y, sample / 16))
            });
            truth.push(black + (white - black) * samples.count() as f64 / 256.0);
        }
    }
    let error = |image: &[u8]| {
        let squares = image.iter().zip(&truth).map(|(value, truth)| (f64::from(*value) - truth).powi(2));
        (squares.sum::<f64>() / truth.len() as f64).sqrt()
    };
    let smooth = chain.image(PostSettings { antialias: Antialias::Fxaa, ..none }, &single, size);
    let double = targets(&chain.gpu, (192, 96), at(2));
    let scaled = chain.image(PostSettings { render_scale: 2.0, ..none }, &double, size);
    let errors = [&jagged, &smooth, &scaled].map(|image| error(image));
    println!("edge error, 8-bit steps: {errors:.3?} (none, fxaa, scale 2)");
    assert!(errors[0] > 4.0, "control: one sample has the error: {errors:?}");
    assert!(errors[1] < 0.5 * errors[0], "{errors:?}");
    assert!(errors[2] < 0.5 * errors[0], "{errors:?}");
}

#[test]
fn sharpening_steepens_a_soft_edge_and_keeps_even_areas() {
    let Some(mut chain) = Chain::open() else { return };
    let size = (32, 8);
    let edge = targets(&chain.gpu, size, |x, _| 0.1 + 0.3 * (f32::from(x as u8) / 2.0 - 7.5).clamp(0.0, 1.0));
    let steepest = |image: &[u8]| image[..32].windows(2).map(|two| two[1].abs_diff(two[0])).max();
    let plain = chain.image(PostSettings::default(), &edge, size);
    let sharp = chain.image(PostSettings { sharpen: 1.0, ..PostSettings::default() }, &edge, size);
    assert!(steepest(&sharp) > steepest(&plain), "{:?} {:?}", &sharp[..32], &plain[..32]);
    for x in [0, 8, 24, 31] {
        assert!(sharp[x].abs_diff(plain[x]) < 2, "{x}");
    }
}

#[test]
fn a_smaller_rendering_fills_the_image_and_resizing_works() {
    let Some(mut chain) = Chain::open() else { return };
    for (rendered, size) in
        [((32, 18), (64, 36)), ((128, 72), (64, 36)), ((1, 1), (3, 5)), ((1, 40), (2, 80))]
    {
        let settings = PostSettings {
            antialias: Antialias::Fxaa,
            bloom: 0.1,
            auto_exposure: true,
            sharpen: 0.5,
            ..PostSettings::default()
        };
        let even = targets(&chain.gpu, rendered, |_, _| 0.25);
        let image = chain.image(settings, &even, size);
        let (least, most) = (image.iter().min().unwrap(), image.iter().max().unwrap());
        assert!(
            image.len() == (size.0 * size.1) as usize && most - least < 2,
            "{rendered:?}: {least} {most}"
        );
        // Control: a picture that is not even.
        if rendered.0 > 1 {
            let halves = targets(&chain.gpu, rendered, |x, _| if x < rendered.0 / 2 { 0.1 } else { 0.4 });
            let image = chain.image(settings, &halves, size);
            assert!(image[0] + 20 < image[size.0 as usize - 1]);
        }
    }
}

#[test]
fn a_pixel_that_is_not_finite_neither_spreads_nor_vanishes() {
    let Some(mut chain) = Chain::open() else { return };
    let (size, middle) = ((64, 64), (20, 30));
    let all = PostSettings {
        auto_exposure: true,
        bloom: 0.3,
        antialias: Antialias::Fxaa,
        sharpen: 1.0,
        ..PostSettings::default()
    };
    for fault in [f32::NAN, f32::INFINITY] {
        let fine = targets(&chain.gpu, size, |_, _| 0.2);
        let broken = targets(&chain.gpu, size, |x, y| if (x, y) == middle { fault } else { 0.2 });
        for settings in [PostSettings::default(), all] {
            let expected = chain.image(settings, &fine, size);
            let image = chain.image(settings, &broken, size);
            assert!(!expected.contains(&BROKEN), "control");
            for (index, (value, expected)) in image.iter().zip(&expected).enumerate() {
                if index == (middle.1 * size.0 + middle.0) as usize {
                    assert_eq!(*value, BROKEN);
                } else {
                    assert!(value.abs_diff(*expected) < 2, "{index}: {value} for {expected}");
                }
            }
        }
        for output in [(32, 32), (128, 128)] {
            let image = chain.image(all, &broken, output);
            let count = image.iter().filter(|value| **value == BROKEN).count();
            assert!((1..=16).contains(&count), "{output:?}: {count}");
        }
    }
}

#[test]
fn shadows_stay_distinguishable_and_every_curve_is_monotone() {
    let Some(mut chain) = Chain::open() else { return };
    // Light in shadow and in the sun on scree, and dark ground at noon.
    let lights = [0.0, 0.008, 0.034, 0.2, 0.5, 1.0, 4.0, 100.0, 6e4];
    let ramp = targets(&chain.gpu, (lights.len() as u32, 1), |x, _| lights[x as usize]);
    let mut curve = |tone| {
        let settings = PostSettings { tone, ..PostSettings::default() };
        chain.image(settings, &ramp, (lights.len() as u32, 1))
    };
    let [agx, filmic, neutral] = [Tone::AgX, Tone::Filmic, Tone::Neutral].map(&mut curve);
    println!("sRGB of {lights:?}: agx {agx:?}, filmic {filmic:?}, neutral {neutral:?}");
    for image in [&agx, &filmic, &neutral] {
        assert!(image.is_sorted() && image[0] < 3 && image[8] > 250, "{image:?}");
    }
    assert!(agx[1] >= 12 && agx[2] >= 50 && agx[3] >= agx[2] + 60, "{agx:?}");
    // Control: the other curves do not keep shadows.
    assert!(filmic[1] < 12 && filmic[2] < 50 && neutral[2] < 30, "{filmic:?} {neutral:?}");
}
