//! Render settings: accuracy against speed, and debug views. Each one is an option of the viewer,
//! most are controls of the panel and words of the uniforms; the numbers are those of
//! `shared/frame.wesl`.

use crate::features::pom::PomSettings;
use crate::features::post::PostSettings;
use crate::features::vegetation::VegetationSettings;
use crate::features::water::{WaterTier, WaveSettings};
use clap::ValueEnum;

/// All render settings: what a frame depends on apart from camera and chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RenderSettings {
    /// Diffuse reflection.
    pub diffuse: Diffuse,
    /// Visibility term of the specular reflection.
    pub visibility: Visibility,
    /// Method against visible repetition of materials.
    pub tiling: Tiling,
    /// Method of the waves' parallax.
    pub water: WaterTier,
    /// Shadows of the terrain on itself.
    pub shadows: Shadows,
    /// Where the terrain's shading normals come from.
    pub normals: Normals,
    /// Debug view.
    pub show: Show,
    /// Position of the sun; that of the scene if none.
    pub sun: Option<SunPosition>,
    /// Exposure in stops relative to the scene's, -8 to 8.
    pub exposure_ev: f32,
    /// Waves and their parallax.
    pub waves: WaveSettings,
    /// Parallax occlusion mapping of materials.
    pub pom: PomSettings,
    /// Vegetation.
    pub plants: VegetationSettings,
    /// From the HDR target to the image.
    pub post: PostSettings,
}

/// Direction of the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SunPosition {
    /// Degrees clockwise from north.
    pub azimuth_deg: f32,
    /// Degrees above the horizon, -90 to 90.
    pub elevation_deg: f32,
}

/// Latitude and declination of the sun's path over a day, degrees: the Canary Islands in May.
const LATITUDE_DEG: f32 = 28.0;
const DECLINATION_DEG: f32 = 18.0;

impl SunPosition {
    /// The position at a time of day, hours of solar time, on the sun's path of a day in May at 28
    /// degrees north (Duffie and Beckman, *Solar Engineering of Thermal Processes*, section 1.6).
    #[must_use]
    pub fn at_hour(hours: f32) -> Self {
        let hour_angle = (15.0 * (hours - 12.0)).to_radians();
        let (latitude, declination) = (LATITUDE_DEG.to_radians(), DECLINATION_DEG.to_radians());
        let sine = latitude.sin() * declination.sin() + latitude.cos() * declination.cos() * hour_angle.cos();
        // From the south, positive in the afternoon.
        let east = hour_angle.sin() * declination.cos();
        let north =
            latitude.sin() * declination.cos() * hour_angle.cos() - latitude.cos() * declination.sin();
        Self {
            azimuth_deg: (180.0 + east.atan2(north).to_degrees()).rem_euclid(360.0),
            elevation_deg: sine.clamp(-1.0, 1.0).asin().to_degrees(),
        }
    }

    /// The position of a unit vector towards the sun: east, up, south.
    #[must_use]
    pub fn of(sun: glam::Vec3) -> Self {
        Self {
            azimuth_deg: sun.x.atan2(-sun.z).to_degrees().rem_euclid(360.0),
            elevation_deg: sun.y.clamp(-1.0, 1.0).asin().to_degrees(),
        }
    }
}

/// Diffuse reflection of rough surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Diffuse {
    /// Constant (Lambertian).
    Lambert,
    /// Brighter towards the light at grazing angles (Burley, "Physically-Based Shading at Disney",
    /// 2012).
    #[default]
    Burley,
}

/// Visibility term of GGX (Heitz, "Understanding the Masking-Shadowing Function", JCGT 3(2), 2014).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Visibility {
    /// Height-correlated Smith term, two square roots.
    #[default]
    Exact,
    /// Its approximation without square roots.
    Fast,
}

/// Method against visible repetition of materials.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Tiling {
    /// Nothing: one sample.
    Off,
    /// The same texture at two scales: two samples.
    TwoScale,
    /// Hexagonal tiles, each turned and shifted: three samples (Mikkelsen, JCGT 11(3), 2022).
    #[default]
    Hex,
}

/// Shadows of the terrain on itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Shadows {
    /// No shadows.
    Off,
    /// Hard edge: the sun is a point.
    Hard,
    /// Penumbra: the sun is a disc.
    #[default]
    Soft,
}

/// Where the terrain's shading normals come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Normals {
    /// The land itself, in a clipmap around the eye, with its sky visibility.
    #[default]
    Land,
    /// The drawn triangles: light changes with the level of detail.
    Mesh,
}

/// Debug view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Show {
    /// The rendered image.
    #[default]
    #[value(name = "picture", alias = "image")]
    Image,
    /// The edges of all triangles.
    Wireframe,
    /// A colour for each level, blended towards the next one by the morph.
    Levels,
    /// Normals as colours.
    Normals,
    /// Bound of the geometric error on screen: green is 0, red the tolerance, white more.
    Error,
    /// A colour for each chunk, a shade for each quarter of it.
    Chunks,
    /// The light of sun and sky on white ground.
    Light,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lighting::SunLight;

    #[test]
    fn the_sun_rises_in_the_east_culminates_in_the_south_and_sets_in_the_west() {
        let at = SunPosition::at_hour;
        let noon = at(12.0);
        assert!(
            (noon.azimuth_deg - 180.0).abs() < 0.1 && (noon.elevation_deg - 80.0).abs() < 0.1,
            "{noon:?}"
        );
        assert!(
            (60.0..90.0).contains(&at(6.0).azimuth_deg) && (270.0..300.0).contains(&at(18.0).azimuth_deg)
        );
        assert!(at(5.0).elevation_deg < 0.0 && at(6.0).elevation_deg > 0.0 && at(0.0).elevation_deg < -40.0);
        for minutes in 0..24 * 60 {
            let (now, next) = (at(minutes as f32 / 60.0), at((minutes + 1) as f32 / 60.0));
            assert!((next.elevation_deg - now.elevation_deg).abs() < 0.3, "minute {minutes}");
        }
    }

    #[test]
    fn a_position_and_its_direction_are_the_same() {
        let position = SunPosition { azimuth_deg: 127.0, elevation_deg: 27.0 };
        let settings = RenderSettings { sun: Some(position), ..RenderSettings::default() };
        let light = SunLight { sun: glam::Vec3::Y, exposure: 1.0 }.with_settings(&settings);
        let back = SunPosition::of(light.sun);
        assert!((back.azimuth_deg - 127.0).abs() < 1e-3 && (back.elevation_deg - 27.0).abs() < 1e-3);
    }
}
