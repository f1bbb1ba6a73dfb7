//! Views of the land, drawn without sea and plants.

use crate::headless_renderer::HeadlessRenderer;
use crate::lod::screen::{self, ViewCase};
use crate::world_builder::WorldBuilder;
use client::cache::ChunkCache;
use client::frame::{Background, FrameData};
use client::gpu::{GpuError, Image};
use client::lod::Selection;
use client::scene::Scene;
use client::settings::{Normals, RenderSettings, Show, SunPosition};
use terrain::Land;

/// Picture size, pixels.
pub const SIZE: (u32, u32) = (480, 270);

/// Stream of the seeded poses.
const STREAM: u32 = 57;

/// Tolerance, pixels, unless a figure varies it.
const TOLERANCE_PX: f64 = 2.0;

/// Slots of the largest view.
const SLOTS: u32 = 6_000;

/// A sun that lights slopes of every direction.
pub const MORNING: SunPosition = SunPosition { azimuth_deg: 127.0, elevation_deg: 27.0 };

/// Whether land at two distances, metres, is one surface: they differ by at most 3 %. Distances
/// that are not positive are no land.
pub fn is_one_surface(one_m: f32, other_m: f32) -> bool {
    let near_m = one_m.min(other_m);
    near_m > 0.0 && (one_m - other_m).abs() <= 0.03 * near_m
}

/// Features to draw at a pose.
#[derive(Clone, Copy, Debug)]
pub struct DrawOptions {
    /// Debug view.
    pub show: Show,
    /// Source of the shading normals.
    pub normals: Normals,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// The sun.
    pub sun: SunPosition,
    /// Shadows of the land.
    pub shadows: client::settings::Shadows,
}

impl DrawOptions {
    /// The lit picture.
    pub const IMAGE: Self = Self {
        show: Show::Image,
        normals: Normals::Land,
        tolerance_px: TOLERANCE_PX,
        sun: MORNING,
        shadows: client::settings::Shadows::Soft,
    };
}

/// A renderer, and the poses.
pub struct Views {
    renderer: HeadlessRenderer,
    builder: WorldBuilder,
    uploaded: Option<Uploaded>,
    /// The poses.
    pub cases: Vec<ViewCase>,
    /// Pixels whose light was no finite number, of all [`Views::light`].
    pub non_finite_pixels: u64,
}

impl Views {
    /// A renderer for so many poses.
    pub fn open(land: Land, poses: u32) -> Result<Self, GpuError> {
        let renderer = HeadlessRenderer::open(SIZE, SLOTS)?;
        let cases = screen::view_cases(&land, poses, STREAM);
        Ok(Self { renderer, builder: WorldBuilder::new(land), uploaded: None, cases, non_finite_pixels: 0 })
    }

    /// Name of the adapter.
    pub fn adapter(&self) -> String {
        self.renderer.adapter()
    }

    /// A picture.
    pub fn image(&mut self, case: &ViewCase, options: DrawOptions) -> Result<Image, GpuError> {
        let frame = self.frame(case, options);
        self.renderer.picture(&frame)
    }

    /// Linear light, four channels a pixel. In debug views the fourth is minus the distance in
    /// metres where land is drawn, and positive elsewhere.
    pub fn light(&mut self, case: &ViewCase, options: DrawOptions) -> Result<Vec<[f32; 4]>, GpuError> {
        let frame = self.frame(case, options);
        let light = self.renderer.linear_light(&frame)?;
        let is_non_finite = |pixel: &&[f32; 4]| pixel[..3].iter().any(|channel| !channel.is_finite());
        self.non_finite_pixels += light.iter().filter(is_non_finite).count() as u64;
        Ok(light)
    }

    fn frame(&mut self, case: &ViewCase, options: DrawOptions) -> FrameData {
        let DrawOptions { show, normals, tolerance_px, sun, shadows } = options;
        let settings = RenderSettings { show, normals, sun: Some(sun), shadows, ..RenderSettings::default() };
        let case = ViewCase { tolerance_px, ..*case };
        let view = case.shot_of(SIZE, settings);
        let uploaded = match self.uploaded.take() {
            // World and selection depend on pose and tolerance alone.
            Some(uploaded) if uploaded.case == case => uploaded,
            other => {
                // Chunks of a pose serve all its tolerances.
                if other.is_none_or(|other| other.case.pose != case.pose) {
                    self.builder.clear();
                }
                let (world, selection) = screen::selected(&mut self.builder, &view);
                self.renderer.upload_world(&world);
                Uploaded { case, world, selection }
            }
        };
        let mut frame = view.frame(Scene::Island, &uploaded.world, &uploaded.selection);
        frame.background = Background::Sky;
        self.uploaded = Some(uploaded);
        frame
    }
}

/// The world that the renderer has.
struct Uploaded {
    case: ViewCase,
    world: ChunkCache,
    selection: Selection,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_of_a_reused_world_equal_those_of_a_new_one() {
        let land = Land::new(1);
        let mut reused = match Views::open(land, 2) {
            Ok(views) => views,
            Err(error) => {
                assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
                eprintln!("NOT TESTED: {error}");
                return;
            }
        };
        let [one, other] = [0, 1].map(|index: usize| reused.cases[index]);
        let low = SunPosition { azimuth_deg: 250.0, elevation_deg: 15.0 };
        let evening = DrawOptions { sun: low, ..DrawOptions::IMAGE };
        let coarse = DrawOptions { tolerance_px: 8.0, ..DrawOptions::IMAGE };
        let image = DrawOptions::IMAGE;
        let mut pictures = Vec::new();
        // Another sun, another tolerance or another pose comes before each.
        for (case, options) in [(one, evening), (one, image), (one, coarse), (other, image), (one, image)] {
            let new = Views::open(land, 2).unwrap().image(&case, options).unwrap();
            assert!(reused.image(&case, options).unwrap().rgba == new.rgba, "{case:?}, {options:?}");
            pictures.push(new.rgba);
        }
        assert!(pictures[..4].iter().enumerate().all(|(n, one)| !pictures[..n].contains(one)), "the control");
        assert!(pictures[4] == pictures[1]);
    }
}
