//! The pass before all others: what sun and sky give in a frame, measured on the GPU and written
//! into the frame's uniforms.

use crate::render::pipeline::compute_pipelines;
use shaders::SHADERS;
use shaders::layout::{Air, Frame};
use std::mem::offset_of;

const AIR_BYTES: u64 = size_of::<Air>() as u64;

/// The pass.
#[derive(Debug)]
pub struct AirPass {
    pipeline: wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    /// Where the shader writes: uniforms are read-only to it.
    measured: wgpu::Buffer,
}

impl AirPass {
    /// The pass over a frame's uniforms.
    #[must_use]
    pub fn new(device: &wgpu::Device, frame: &wgpu::Buffer) -> Self {
        let shader = SHADERS.measure_sky;
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(shader.name),
            entries: &[
                entry(0, wgpu::BufferBindingType::Uniform),
                entry(1, wgpu::BufferBindingType::Storage { read_only: false }),
            ],
        });
        let measured = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("air"),
            size: AIR_BYTES,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(shader.name),
            layout: &layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: measured.as_entire_binding() },
            ],
        });
        let [pipeline] = compute_pipelines(device, &shader, &[&layout], ["measure_sky"]);
        Self { pipeline, bindings, measured }
    }

    /// Records the measurement; passes that are recorded later read it from `frame`, the buffer
    /// that the pass was made for.
    pub fn measure(&self, encoder: &mut wgpu::CommandEncoder, frame: &wgpu::Buffer) {
        let mut pass = encoder
            .begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some("air"), timestamp_writes: None });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&self.measured, 0, frame, offset_of!(Frame, air) as u64, AIR_BYTES);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Lens, Pose};
    use crate::frame::Shot;
    use crate::looks::{Looks, SunPlace};
    use crate::render::{Gpu, GpuError};
    use crate::scene::Scene;
    use crate::world::{World, select};
    use std::sync::mpsc;

    /// What the air does on a stretch of a ray, and the sky behind it.
    #[derive(Clone, Copy, Debug)]
    struct Stretch {
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
        let sun = Some(SunPlace { azimuth_deg: 90.0, elevation_deg: sun_elevation_deg });
        let shot = Shot {
            pose,
            lens: Lens { fov_deg: 60.0, width: 64, height: 36 },
            view_distance_m: 1000,
            tolerance_px: 4.0,
            time_s: 0.0,
            looks: Looks { sun, ..Looks::default() },
        };
        let mut world = World::new(8);
        let selection = select(&mut world, &shot.viewer());
        shot.frame(Scene::Island, &world, &selection).uniforms
    }

    /// Measures the sky of a frame, then asks for stretches of `(direction, distance in metres)`.
    /// Returns what was measured too.
    fn ask(gpu: &Gpu, frame: &Frame, stretches: &[([f32; 3], f32)]) -> (Air, Vec<Stretch>) {
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
        let questions: Vec<[f32; 4]> = stretches.iter().map(|([x, y, z], far)| [*x, *y, *z, *far]).collect();
        let probes = buffer(16 * questions.len(), Usage::STORAGE | Usage::COPY_DST);
        gpu.queue.write_buffer(&probes, 0, bytemuck::cast_slice(&questions));
        let lights = buffer(48 * questions.len(), Usage::STORAGE | Usage::COPY_SRC);
        let landing = buffer(48 * questions.len() + size_of::<Air>(), Usage::MAP_READ | Usage::COPY_DST);
        let shader = SHADERS.probe_air;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(shader.name),
            source: wgpu::ShaderSource::Wgsl(shader.wgsl.into()),
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(shader.name),
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: uniforms.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: probes.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: lights.as_entire_binding() },
            ],
        });
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        AirPass::new(device, &uniforms).measure(&mut encoder, &uniforms);
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups((questions.len() as u32).div_ceil(64), 1, 1);
        }
        encoder.copy_buffer_to_buffer(&lights, 0, &landing, 0, 48 * questions.len() as u64);
        encoder.copy_buffer_to_buffer(
            &uniforms,
            offset_of!(Frame, air) as u64,
            &landing,
            48 * questions.len() as u64,
            AIR_BYTES,
        );
        gpu.queue.submit([encoder.finish()]);
        let (told, tell) = mpsc::channel();
        landing.map_async(wgpu::MapMode::Read, .., move |outcome| told.send(outcome).unwrap());
        gpu.wait().unwrap();
        tell.recv().unwrap().unwrap();
        let mapped = landing.get_mapped_range(..).unwrap();
        let words: &[f32] = bytemuck::cast_slice(&mapped);
        let (lights, air) = words.split_at(12 * questions.len());
        let rgb = |words: &[f32]| [words[0], words[1], words[2]];
        let stretches = lights.chunks_exact(12).map(|words| Stretch {
            left: rgb(words),
            added: rgb(&words[4..]),
            sky: rgb(&words[8..]),
        });
        (*bytemuck::from_bytes(bytemuck::cast_slice(air)), stretches.collect())
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

    fn stretches() -> Vec<([f32; 3], f32)> {
        directions().into_iter().flat_map(|direction| DISTANCES_M.map(|far| (direction, far))).collect()
    }

    #[test]
    fn air_is_finite_everywhere_grows_with_distance_and_ends_as_the_sky() {
        let Some(gpu) = device() else { return };
        for height_m in HEIGHTS_M {
            for sun_deg in SUNS_DEG {
                let (air, found) = ask(&gpu, &uniforms(height_m, sun_deg), &stretches());
                let place = format!("eye {height_m} m, sun {sun_deg} degrees");
                let measured: &[f32; size_of::<Air>() / 4] = bytemuck::cast_ref(&air);
                assert!(measured.iter().all(|value| value.is_finite()), "{place}: {air:?}");
                for (ray, direction) in found.chunks_exact(DISTANCES_M.len()).zip(directions()) {
                    for channel in 0..3 {
                        let told = || format!("{place}, direction {direction:?}, channel {channel}: {ray:?}");
                        for stretch in ray {
                            assert!((0.0..=1.0).contains(&stretch.left[channel]), "{}", told());
                            assert!((0.0..100.0).contains(&stretch.added[channel]), "{}", told());
                            assert!(stretch.sky[channel] > 0.0, "no sky is black: {}", told());
                        }
                        // Rounding of the closed form: 2^-24 of the air on a whole level ray.
                        let slack = 2e-5 * (1.0 + ray[0].sky[channel]);
                        let grows = |a: &Stretch, b: &Stretch| {
                            a.left[channel] >= b.left[channel] - slack
                                && a.added[channel] <= b.added[channel] + slack
                        };
                        assert!(ray.is_sorted_by(grows), "{}", told());
                        let (far, sky) = (ray[7].added[channel], ray[7].sky[channel]);
                        assert!((far - sky).abs() <= 1e-4 + 0.01 * sky, "{}", told());
                        // The control: a stretch that does not reach through the air is not the
                        // sky.
                        assert!((ray[2].added[channel] - sky).abs() > 0.05 * sky, "{}", told());
                    }
                }
            }
        }
    }

    /// Share of light left after a stretch, by 20,000 steps in f64 on a round earth, for one
    /// channel.
    fn truth(height_m: f64, rise: f64, distance_m: f64, scattering: f64, extinction: f64) -> f64 {
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
    fn the_closed_form_leaves_the_light_that_integration_leaves() {
        let Some(gpu) = device() else { return };
        let channels = [(5.8e-6, 0.88e-5), (13.5e-6, 0.90e-5), (33.1e-6, 0.92e-5)];
        let (mut worst, mut worst_without_haze) = (0.0f64, 0.0f64);
        for height_m in [0.0, 300.0, 4000.0, 20_000.0f64] {
            // Down to where rays meet the sea, which the truth has none of.
            let dip = -(2.0 * height_m / 6_371_000.0).sqrt();
            let rises = [0.95 * dip, 0.5 * dip, 0.001, 0.01, 0.05, 0.2, 0.7, 1.0];
            let rays: Vec<([f32; 3], f32)> = rises
                .iter()
                .flat_map(|rise| {
                    let level = (1.0 - rise * rise).sqrt() as f32;
                    [2e3, 2e4, 6e4, 3e5].map(|far| ([level, *rise as f32, 0.0], far))
                })
                .collect();
            let (_, found) = ask(&gpu, &uniforms(height_m, 45.0), &rays);
            for (([_, rise, _], far), stretch) in rays.iter().zip(found) {
                for (channel, (scattering, extinction)) in channels.into_iter().enumerate() {
                    let left = f64::from(stretch.left[channel]);
                    let (rise, far) = (f64::from(*rise), f64::from(*far));
                    worst = worst.max((left - truth(height_m, rise, far, scattering, extinction)).abs());
                    let clear = truth(height_m, rise, far, scattering, 0.0);
                    worst_without_haze = worst_without_haze.max((left - clear).abs());
                }
            }
        }
        eprintln!(
            "worst error of the share of light left: {worst:.5}, against air without haze {worst_without_haze:.5}"
        );
        assert!(worst < 0.005, "{worst}");
        assert!(worst_without_haze > 0.1, "the control must fail: {worst_without_haze}");
    }

    #[test]
    fn a_low_sun_is_orange_dusk_is_dim_and_night_is_a_dim_blue() {
        let Some(gpu) = device() else { return };
        let measured = |sun_deg: f32| ask(&gpu, &uniforms(2.0, sun_deg), &[([0.0, 1.0, 0.0], 1e6)]).0;
        let (noon, evening, dusk, night) = (measured(60.0), measured(2.0), measured(-5.0), measured(-40.0));
        let warmth = |light: [f32; 4]| light[0] / light[2].max(1e-9);
        assert!(warmth(noon.sun) < 1.5 && warmth(evening.sun) > 5.0, "{:?} {:?}", noon.sun, evening.sun);
        assert!(warmth(noon.sky_mean) < 0.8, "the sky is blue: {:?}", noon.sky_mean);
        assert!(night.sun[..3].iter().all(|value| *value < 1e-6), "{:?}", night.sun);
        let brightness = |air: &Air| air.sky_mean[..3].iter().sum::<f32>();
        let [noon, evening, dusk, night_light] = [&noon, &evening, &dusk, &night].map(brightness);
        assert!(
            noon > evening && evening > 2.0 * dusk && dusk > 2.0 * night_light,
            "{noon} {evening} {dusk} {night_light}"
        );
        assert!((0.001..0.05).contains(&night_light) && warmth(night.sky_mean) < 0.7, "{:?}", night.sky_mean);
    }
}
