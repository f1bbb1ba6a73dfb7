//! Integrates sun and sky light on the GPU, before all other passes, into the frame's uniforms.

use crate::gpu::bind::{bind_buffers, compute_uniform_entry, layout, storage_entry};
use crate::gpu::buffer::create_buffer;
use crate::gpu::pipeline::compute_pipelines;
use shaders::SHADERS;
use shaders::layout::{Atmosphere, Frame};
use std::mem::offset_of;

const ATMOSPHERE_BYTES: u64 = size_of::<Atmosphere>() as u64;

/// The integration pass.
#[derive(Debug)]
pub struct AtmospherePass {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    /// Output of the shader: uniform buffers are read-only.
    result: wgpu::Buffer,
}

impl AtmospherePass {
    /// The pass over a frame's uniforms.
    #[must_use]
    pub fn new(device: &wgpu::Device, frame: &wgpu::Buffer) -> Self {
        let shader = SHADERS.integrate_sky;
        let entries = [compute_uniform_entry(0), storage_entry(1, wgpu::ShaderStages::COMPUTE, false)];
        let layout = layout(device, shader.name, &entries);
        let result = create_buffer(
            device,
            "atmosphere",
            ATMOSPHERE_BYTES,
            wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        );
        let bindings = bind_buffers(device, shader.name, &layout, &[frame, &result]);
        let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["integrate_sky"]);
        Self { pipeline, bindings, result }
    }

    /// Records the integration; later passes read the result from `frame`, the buffer that the pass
    /// was created with.
    pub fn integrate(&self, encoder: &mut wgpu::CommandEncoder, frame: &wgpu::Buffer) {
        let descriptor = wgpu::ComputePassDescriptor { label: Some("atmosphere"), timestamp_writes: None };
        let mut pass = encoder.begin_compute_pass(&descriptor);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(
            &self.result,
            0,
            frame,
            offset_of!(Frame, atmosphere) as u64,
            ATMOSPHERE_BYTES,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cache::ChunkCache;
    use crate::camera::{Pose, Projection};
    use crate::gpu::pipeline::derived_compute_pipelines;
    use crate::gpu::{Gpu, GpuError};
    use crate::lod::select;
    use crate::scene::Scene;
    use crate::settings::{RenderSettings, SunPosition};
    use crate::view::ViewParams;

    /// Scattering and transmittance of the air on a segment of a ray, and the sky behind it.
    #[derive(Clone, Copy, Debug)]
    struct Segment {
        left: [f32; 3],
        added: [f32; 3],
        sky: [f32; 3],
    }

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

    fn uniforms(eye_height_m: f64, sun_elevation_deg: f32) -> Frame {
        let pose: Pose = format!("0,{eye_height_m},0,0,0").parse().unwrap();
        let sun = Some(SunPosition { azimuth_deg: 90.0, elevation_deg: sun_elevation_deg });
        let view = ViewParams {
            pose,
            projection: Projection { fov_deg: 60.0, width: 64, height: 36 },
            view_distance_m: 1000,
            tolerance_px: 4.0,
            time_s: 0.0,
            settings: RenderSettings { sun, ..RenderSettings::default() },
        };
        let mut cache = ChunkCache::new(8);
        let selection = select(&mut cache, &view.viewer());
        view.frame(Scene::Island, &cache, &selection).uniforms
    }

    /// Measures the sky of a frame, then asks for segments of `(direction, distance in metres)`.
    /// Returns what was measured too.
    fn probe(gpu: &Gpu, frame: &Frame, segments: &[([f32; 3], f32)]) -> (Atmosphere, Vec<Segment>) {
        use wgpu::BufferUsages as Usage;
        let device = &gpu.device;
        let buffer = |size: usize, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size: size as u64,
                usage,
                mapped_at_creation: false,
            })
        };
        let uniforms = buffer(size_of::<Frame>(), Usage::UNIFORM | Usage::COPY_DST | Usage::COPY_SRC);
        gpu.queue.write_buffer(&uniforms, 0, bytemuck::bytes_of(frame));
        let segments_words: Vec<[f32; 4]> =
            segments.iter().map(|([x, y, z], far)| [*x, *y, *z, *far]).collect();
        let probes = buffer(16 * segments_words.len(), Usage::STORAGE | Usage::COPY_DST);
        gpu.queue.write_buffer(&probes, 0, bytemuck::cast_slice(&segments_words));
        let lights = buffer(48 * segments_words.len(), Usage::STORAGE | Usage::COPY_SRC);
        let shader = SHADERS.probe_atmosphere;
        let [pipeline] = derived_compute_pipelines(device, &shader, [shader.entry_points[0].name]);
        let group = pipeline.get_bind_group_layout(0);
        let bindings = bind_buffers(device, shader.name, &group, &[&uniforms, &probes, &lights]);
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        AtmospherePass::new(device, &uniforms).integrate(&mut encoder, &uniforms);
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups((segments_words.len() as u32).div_ceil(64), 1, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        let air_at = offset_of!(Frame, atmosphere) as u64;
        let air = gpu.read_buffer(&uniforms, air_at..air_at + ATMOSPHERE_BYTES).unwrap();
        let lights = gpu.read_buffer(&lights, 0..48 * segments_words.len() as u64).unwrap();
        let lights: &[f32] = bytemuck::cast_slice(&lights);
        let rgb = |words: &[f32]| [words[0], words[1], words[2]];
        let segments = lights.chunks_exact(12).map(|words| Segment {
            left: rgb(words),
            added: rgb(&words[4..]),
            sky: rgb(&words[8..]),
        });
        (bytemuck::pod_read_unaligned(&air), segments.collect())
    }

    const HEIGHTS_M: [f64; 6] = [-64.0, 0.0, 2.0, 300.0, 4000.0, 20_000.0];
    const SUNS_DEG: [f32; 10] = [-90.0, -30.0, -10.0, -3.0, -1.0, 0.0, 1.0, 10.0, 45.0, 90.0];
    const DISTANCES_M: [f32; 9] = [0.01, 1.0, 30.0, 1e3, 8e3, 4e4, 2e5, 1e6, 1e7];

    /// Directions all around, close to each other at the horizon, exactly level, straight up and
    /// straight down.
    fn directions() -> Vec<[f32; 3]> {
        let rises = [
            -90.0, -60.0, -20.0, -5.0, -3.0, -1.0, -0.3, -0.01, 0.0, 0.01, 0.3, 1.0, 5.0, 20.0, 60.0, 90.0f32,
        ];
        let around = [0.0, 60.0, 90.0, 135.0, 180.0, 270.0f32];
        rises
            .into_iter()
            .flat_map(|rise| {
                let (up, level) = rise.to_radians().sin_cos();
                around.map(|azimuth| {
                    let (east, north) = azimuth.to_radians().sin_cos();
                    [east * level, up, -north * level]
                })
            })
            .collect()
    }

    fn segments() -> Vec<([f32; 3], f32)> {
        directions().into_iter().flat_map(|direction| DISTANCES_M.map(|far| (direction, far))).collect()
    }

    #[test]
    fn scattering_is_finite_grows_with_distance_and_ends_as_the_sky() {
        let Some(gpu) = device() else { return };
        for height_m in HEIGHTS_M {
            for sun_deg in SUNS_DEG {
                let (air, found) = probe(&gpu, &uniforms(height_m, sun_deg), &segments());
                let place = format!("eye {height_m} m, sun {sun_deg} degrees");
                let measured: &[f32; size_of::<Atmosphere>() / 4] = bytemuck::cast_ref(&air);
                assert!(measured.iter().all(|value| value.is_finite()), "{place}: {air:?}");
                for (ray, direction) in found.chunks_exact(DISTANCES_M.len()).zip(directions()) {
                    for channel in 0..3 {
                        let place_text =
                            || format!("{place}, direction {direction:?}, channel {channel}: {ray:?}");
                        for segment in ray {
                            assert!((0.0..=1.0).contains(&segment.left[channel]), "{}", place_text());
                            assert!((0.0..100.0).contains(&segment.added[channel]), "{}", place_text());
                            assert!(segment.sky[channel] > 0.0, "no sky is black: {}", place_text());
                        }
                        // Rounding of the closed form: 2^-24 of the air on a whole level ray.
                        let slack = 2e-5 * (1.0 + ray[0].sky[channel]);
                        let grows = |a: &Segment, b: &Segment| {
                            a.left[channel] >= b.left[channel] - slack
                                && a.added[channel] <= b.added[channel] + slack
                        };
                        assert!(ray.is_sorted_by(grows), "{}", place_text());
                        let (far, sky) = (ray[7].added[channel], ray[7].sky[channel]);
                        assert!((far - sky).abs() <= 1e-4 + 0.01 * sky, "{}", place_text());
                        // The control: a segment that does not reach through the air is not the
                        // sky.
                        assert!((ray[2].added[channel] - sky).abs() > 0.05 * sky, "{}", place_text());
                    }
                }
            }
        }
    }

    /// Share of light left after a segment, by 20,000 steps in f64 on a round earth, for one
    /// channel.
    fn reference(height_m: f64, rise: f64, distance_m: f64, scattering: f64, extinction: f64) -> f64 {
        const STEPS: u32 = 20_000;
        let (mut air, mut haze) = (0.0, 0.0);
        let radius_m = 6_371_000.0 + height_m;
        for step in 0..STEPS {
            // Finer near the eye.
            let part = (f64::from(step) + 0.5) / f64::from(STEPS);
            let (at_m, length_m) = (part * part * distance_m, 2.0 * part * distance_m / f64::from(STEPS));
            let high_m =
                (radius_m * radius_m + 2.0 * radius_m * rise * at_m + at_m * at_m).sqrt() - 6_371_000.0;
            air += (-high_m / 8000.0).exp() * length_m;
            haze += (-high_m / 1200.0).exp() * length_m;
        }
        (-(scattering * air + extinction * haze)).exp()
    }

    #[test]
    fn the_closed_form_equals_numerical_integration() {
        let Some(gpu) = device() else { return };
        let channels = [(5.8e-6, 0.88e-5), (13.5e-6, 0.90e-5), (33.1e-6, 0.92e-5)];
        let (mut worst, mut worst_without_haze) = (0.0f64, 0.0f64);
        for height_m in [0.0, 300.0, 4000.0, 20_000.0f64] {
            // Down to where rays meet the sea, which the reference lacks.
            let dip = -(2.0 * height_m / 6_371_000.0).sqrt();
            let rises = [0.95 * dip, 0.5 * dip, 0.001, 0.01, 0.05, 0.2, 0.7, 1.0];
            let rays: Vec<([f32; 3], f32)> = rises
                .iter()
                .flat_map(|rise| {
                    let level = (1.0 - rise * rise).sqrt() as f32;
                    [2e3, 2e4, 6e4, 3e5].map(|far| ([level, *rise as f32, 0.0], far))
                })
                .collect();
            let (_, found) = probe(&gpu, &uniforms(height_m, 45.0), &rays);
            for (([_, rise, _], far), segment) in rays.iter().zip(found) {
                for (channel, (scattering, extinction)) in channels.into_iter().enumerate() {
                    let left = f64::from(segment.left[channel]);
                    let (rise, far) = (f64::from(*rise), f64::from(*far));
                    worst = worst.max((left - reference(height_m, rise, far, scattering, extinction)).abs());
                    let clear = reference(height_m, rise, far, scattering, 0.0);
                    worst_without_haze = worst_without_haze.max((left - clear).abs());
                }
            }
        }
        eprintln!(
            "worst error of the share of light left: {worst:.5}, against air without haze \
             {worst_without_haze:.5}"
        );
        assert!(worst < 0.005, "{worst}");
        assert!(worst_without_haze > 0.1, "the control must fail: {worst_without_haze}");
    }

    #[test]
    fn a_low_sun_is_orange_dusk_is_dim_and_night_is_a_dim_blue() {
        let Some(gpu) = device() else { return };
        let measured = |sun_deg: f32| probe(&gpu, &uniforms(2.0, sun_deg), &[([0.0, 1.0, 0.0], 1e6)]).0;
        let (noon, evening, dusk, night) = (measured(60.0), measured(2.0), measured(-5.0), measured(-40.0));
        let warmth = |light: [f32; 4]| light[0] / light[2].max(1e-9);
        assert!(warmth(noon.sun) < 1.5 && warmth(evening.sun) > 5.0, "{:?} {:?}", noon.sun, evening.sun);
        assert!(warmth(noon.sky_mean) < 0.8, "the sky is blue: {:?}", noon.sky_mean);
        assert!(night.sun[..3].iter().all(|value| *value < 1e-6), "{:?}", night.sun);
        let brightness = |air: &Atmosphere| air.sky_mean[..3].iter().sum::<f32>();
        let [noon, evening, dusk, night_light] = [&noon, &evening, &dusk, &night].map(brightness);
        assert!(
            noon > evening && evening > 2.0 * dusk && dusk > 2.0 * night_light,
            "{noon} {evening} {dusk} {night_light}"
        );
        assert!((0.001..0.05).contains(&night_light) && warmth(night.sky_mean) < 0.7, "{:?}", night.sky_mean);
    }
}
