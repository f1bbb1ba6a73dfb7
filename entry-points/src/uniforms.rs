//! Numbers of a view and its settings, by the uniforms of a frame.

use clap::ValueEnum;
use client::cache::ChunkCache;
use client::camera::{Pose, Projection};
use client::features::pom::PomSettings;
use client::features::pom::settings::Horizon;
use client::features::post::PostSettings;
use client::features::vegetation::VegetationSettings;
use client::features::water::WaveSettings;
use client::lod::Selection;
use client::scene::Scene;
use client::settings::{RenderSettings, SunPosition};
use client::view::ViewParams;
use glam::DVec3;
use std::cell::RefCell;

/// Bytes of all numbers of a view.
const LENGTH: usize = 148;

thread_local! {
    /// No chunk: the numbers of a view do not depend on any.
    static CACHE: RefCell<ChunkCache> = RefCell::new(ChunkCache::new(1));
}

/// Computes the uniforms of a frame. Bytes are its numbers, missing ones are 0.
///
/// # Panics
/// A uniform is infinite or no number.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let mut numbers = Numbers(bytes);
    let scene = numbers.choice::<Scene>();
    let view = view(&mut numbers);
    let frame = CACHE.with_borrow(|cache| view.frame(scene, cache, &Selection::default()));
    // Two fractions in one word, which is no float.
    let uniforms = shaders::layout::Frame { grass: 0, ..frame.uniforms };
    let floats: &[f32] = bytemuck::cast_slice(bytemuck::bytes_of(&uniforms));
    assert!(floats.iter().all(|float| float.is_finite()), "{uniforms:?} of {view:?}");
    assert!(frame.post.exposure_ev.is_finite(), "{:?} of {view:?}", frame.post);
    bytes.len() >= LENGTH
}

/// A view of zeros, one of ones, one of invalid numbers.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let repeated = |float: f32| float.to_le_bytes().repeat(LENGTH / 4);
    [0.0, 1.0, 100.0, f32::NAN, f32::INFINITY, f32::MAX].map(repeated).into()
}

/// Reads numbers one after another.
struct Numbers<'a>(&'a [u8]);

impl Numbers<'_> {
    fn next<const N: usize>(&mut self) -> [u8; N] {
        let (head, rest) = self.0.split_at(N.min(self.0.len()));
        self.0 = rest;
        let mut bytes = [0; N];
        bytes[..head.len()].copy_from_slice(head);
        bytes
    }

    fn float(&mut self) -> f32 {
        f32::from_le_bytes(self.next())
    }

    fn integer(&mut self) -> u32 {
        u32::from_le_bytes(self.next())
    }

    fn choice<T: ValueEnum + Copy>(&mut self) -> T {
        let [byte] = self.next();
        let variants = T::value_variants();
        variants[usize::from(byte) % variants.len()]
    }
}

fn view(numbers: &mut Numbers<'_>) -> ViewParams {
    let [x, y, z, yaw_deg, pitch_deg, fov_deg, tolerance_px] = [(); 7].map(|()| f64::from(numbers.float()));
    ViewParams {
        pose: Pose { position_m: DVec3::new(x, y, z), yaw_deg, pitch_deg },
        projection: Projection { fov_deg, width: numbers.integer(), height: numbers.integer() },
        view_distance_m: numbers.integer(),
        tolerance_px,
        time_s: numbers.float(),
        settings: settings(numbers),
    }
}

fn settings(numbers: &mut Numbers<'_>) -> RenderSettings {
    let [azimuth_deg, elevation_deg, exposure_ev] = [(); 3].map(|()| numbers.float());
    RenderSettings {
        diffuse: numbers.choice(),
        visibility: numbers.choice(),
        tiling: numbers.choice(),
        water: numbers.choice(),
        shadows: numbers.choice(),
        normals: numbers.choice(),
        show: numbers.choice(),
        sun: (numbers.next::<1>() != [0]).then_some(SunPosition { azimuth_deg, elevation_deg }),
        exposure_ev,
        waves: WaveSettings {
            parallax_factor: numbers.float(),
            parallax_bias_m: numbers.float(),
            steepness: numbers.float(),
        },
        pom: pom(numbers),
        plants: plants(numbers),
        post: PostSettings {
            auto_exposure: numbers.next::<1>() != [0],
            bloom: numbers.float(),
            sharpen: numbers.float(),
            render_scale: numbers.float(),
            ..PostSettings::default()
        },
    }
}

fn pom(numbers: &mut Numbers<'_>) -> PomSettings {
    PomSettings {
        method: numbers.choice(),
        steps_min: numbers.integer(),
        steps_max: numbers.integer(),
        refinements: numbers.integer(),
        silhouette: numbers.choice(),
        pivot: numbers.float(),
        amplitude: numbers.float(),
        tiling: [numbers.float(), numbers.float()],
        fade_px: numbers.float(),
        horizon: Horizon {
            strength: numbers.float(),
            height_bias: numbers.float(),
            safe_threshold: numbers.float(),
            falloff: numbers.float(),
        },
        ..PomSettings::default()
    }
}

/// Grass alone: plants are placed on chunks, of which there are none.
fn plants(numbers: &mut Numbers<'_>) -> VegetationSettings {
    VegetationSettings { density: numbers.integer(), range_m: numbers.float(), ..VegetationSettings::NONE }
}
