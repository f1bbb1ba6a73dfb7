//! The scenes, with their light and start camera.

pub mod objects;
pub mod places;

use crate::camera::Pose;
use crate::features::vegetation::VegetationSettings;
use crate::lighting::SunLight;
use glam::{DVec3, Vec3};
use std::sync::LazyLock;
use terrain::constants::UNITS_PER_METRE;
use terrain::{Land, Position};

/// The seed whose land a scene generates by default.
pub const DEFAULT_WORLD_SEED: u64 = 1;

/// The start of the island scene is this far out at sea from the start of the world and this high
/// above sea and ground, metres: the shore is in the picture below the mountains.
const OFF_SHORE_M: f64 = 60.0;
const ABOVE_M: f64 = 25.0;

/// A scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Scene {
    /// The streamed archipelago.
    #[default]
    Island,
    /// The island at eye height, with grass and trees. Generates its land unless --connect is given
    Grass,
    /// The island with heights times 1.8, so that hills occlude vegetation. Generates its land
    /// unless --connect is given
    Culling,
    /// A bay in three parts: parallax mapping, the selected --water method, the ray-marched
    /// reference. Needs no server
    Water,
    /// Cobbles on four planes: flat, single offset, by the settings, displaced geometry. Needs no
    /// server
    Pom,
    /// A brick wall by parallax only. Needs no server
    Brick,
    /// A plane, a sphere, a capsule and a cube with silhouettes. Needs no server
    Spom,
}

impl Scene {
    /// Whether the scene needs neither server nor chunks.
    #[must_use]
    pub fn is_local(self) -> bool {
        match self {
            Self::Island | Self::Grass | Self::Culling => false,
            Self::Water | Self::Pom | Self::Brick | Self::Spom => true,
        }
    }

    /// Whether the scene is as small as a room: the camera is slower and closer.
    #[must_use]
    pub fn is_indoor(self) -> bool {
        match self {
            Self::Island | Self::Grass | Self::Culling | Self::Water => false,
            Self::Pom | Self::Brick | Self::Spom => true,
        }
    }

    /// Legend of a local scene's parts, for the panel.
    #[must_use]
    pub fn panel_legend(self) -> Option<&'static str> {
        match self {
            Self::Island | Self::Grass | Self::Culling => None,
            Self::Water => Some("left: plain parallax, middle: --water, right: reference"),
            Self::Pom => Some("from left: flat, one offset, --relief, displaced geometry"),
            Self::Brick => Some("a flat wall: look along it to see where parallax ends"),
            Self::Spom => Some("from left: plane, sphere, capsule, cube; cut by --silhouette"),
        }
    }

    /// Start camera in the world of [`DEFAULT_WORLD_SEED`].
    #[must_use]
    pub fn start(self) -> Pose {
        static ISLAND: LazyLock<Pose> = LazyLock::new(|| shore(&Land::new(DEFAULT_WORLD_SEED)));
        match self {
            Self::Island => *ISLAND,
            // A meadow with woods and mountains behind it.
            Self::Grass => {
                Pose { position_m: DVec3::new(720.0, 46.1, 1260.0), yaw_deg: 345.0, pitch_deg: 2.0 }
            }
            // Floor of a narrow valley: its sides occlude almost all vegetation in view.
            Self::Culling => {
                Pose { position_m: DVec3::new(-320.0, 26.2, 704.0), yaw_deg: 218.0, pitch_deg: -2.0 }
            }
            Self::Water => Pose { position_m: DVec3::new(0.0, 7.5, 7.0), yaw_deg: 0.0, pitch_deg: -29.0 },
            // 16 degrees above the planes, looking at their middle.
            Self::Pom => Pose { position_m: DVec3::new(0.0, 3.64, 12.70), yaw_deg: 0.0, pitch_deg: -16.0 },
            Self::Brick => Pose { position_m: DVec3::new(-2.6, 1.7, 3.3), yaw_deg: 30.0, pitch_deg: -6.0 },
            Self::Spom => Pose { position_m: DVec3::new(-0.1, 2.55, 6.5), yaw_deg: 0.0, pitch_deg: -16.0 },
        }
    }

    /// Start camera in a world. Only the island's depends on it. Finding it takes some 20 ms,
    /// rarely 0.4 s: not for a frame. It needs the land alone, so any thread or worker can find it.
    #[must_use]
    pub fn start_in(self, land: &Land) -> Pose {
        if self == Self::Island && land.world_seed() != DEFAULT_WORLD_SEED {
            shore(land)
        } else {
            self.start()
        }
    }

    /// Whether the scene generates its land without a server.
    #[must_use]
    pub fn has_own_land(self) -> bool {
        matches!(self, Self::Grass | Self::Culling)
    }

    /// Vegetation of the scene.
    #[must_use]
    pub fn plants(self) -> VegetationSettings {
        match self {
            Self::Grass => VegetationSettings::STANDARD,
            Self::Culling => VegetationSettings::SPARSE,
            _ => VegetationSettings::NONE,
        }
    }

    /// Vertical scale of the land.
    #[must_use]
    pub fn vertical_scale(self) -> f64 {
        if self == Self::Culling { 1.8 } else { 1.0 }
    }

    /// Distance to the point that the start camera circles in orbit mode, metres.
    #[must_use]
    pub fn orbit_radius_m(self) -> f64 {
        match self {
            Self::Island => 2000.0,
            Self::Grass | Self::Culling => 60.0,
            Self::Water => 20.0,
            Self::Pom => 13.2,
            Self::Brick => 3.8,
            Self::Spom => 6.8,
        }
    }

    /// Light of the scene: a late morning sun in the south-east; over the bay a sun beyond it, for
    /// glitter.
    #[must_use]
    pub fn light(self) -> SunLight {
        match self {
            Self::Island | Self::Grass | Self::Culling => {
                SunLight { sun: Vec3::new(0.66, 0.43, 0.50).normalize(), exposure: 1.0 }
            }
            Self::Water => SunLight { sun: Vec3::new(0.62, 0.58, -0.50).normalize(), exposure: 1.0 },
            // From the far side, almost centred, so that all four planes are lit alike.
            Self::Pom => SunLight { sun: Vec3::new(-0.20, 0.50, -0.55).normalize(), exposure: 1.0 },
            // Low and from the side, for long shadows.
            Self::Spom => SunLight { sun: Vec3::new(-0.62, 0.50, 0.30).normalize(), exposure: 0.85 },
            Self::Brick => SunLight { sun: Vec3::new(-0.62, 0.55, 0.55).normalize(), exposure: 1.0 },
        }
    }
}

/// Off the start of a world, looking inland. In tenths of metres and degrees, which a written pose
/// holds.
fn shore(land: &Land) -> Pose {
    let start = land.start();
    let tenths = |value: f64| (value * 10.0).round() / 10.0;
    let inland = [start.inland.0, start.inland.1].map(|part| f64::from(part) / 32_768.0);
    let [east, south] = [(start.x, inland[0]), (start.z, inland[1])]
        .map(|(units, inland)| tenths(f64::from(units) / f64::from(UNITS_PER_METRE) - OFF_SHORE_M * inland));
    let units = |metres: f64| (metres * f64::from(UNITS_PER_METRE)) as i32;
    let ground = Position::new(units(east), units(south)).map_or(0, |place| land.height_at(place).max(0));
    let up = tenths(f64::from(ground) / f64::from(UNITS_PER_METRE) + ABOVE_M);
    let yaw_deg = tenths(inland[0].atan2(-inland[1]).to_degrees().rem_euclid(360.0));
    Pose { position_m: DVec3::new(east, up, south), yaw_deg, pitch_deg: -4.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;

    fn height_m(land: &Land, place: DVec3) -> f64 {
        let [x, z] = [place.x, place.z].map(|metres| (metres * 256.0) as i32);
        f64::from(land.height_at(Position::new(x, z).unwrap())) / 256.0
    }

    #[test]
    fn the_island_scene_starts_off_a_shore_with_mountains_ahead_in_every_world() {
        for seed in 0..8 {
            let land = Land::new(seed);
            let pose = Scene::Island.start_in(&land);
            let ground_m = height_m(&land, pose.position_m).max(0.0);
            assert!((24.9..=25.1).contains(&(pose.position_m.y - ground_m)), "world {seed}: {pose}");
            let ahead = |metres: f64| pose.position_m + pose.forward().with_y(0.0).normalize() * metres;
            assert!(height_m(&land, ahead(OFF_SHORE_M)) > 0.0, "world {seed}: {pose} looks at the shore");
            let highest = (1..40).map(|n| height_m(&land, ahead(100.0 * f64::from(n)))).fold(0.0, f64::max);
            assert!(highest > 60.0, "world {seed}: {highest} m ahead");
            let sea = (0..40).any(|n| height_m(&land, ahead(OFF_SHORE_M - 10.0 * f64::from(n))) < 0.0);
            assert!(sea, "world {seed}: no sea before the shore");
            assert_eq!(pose.to_string().parse::<Pose>(), Ok(pose), "a written pose is the same");
        }
        assert_eq!(Scene::Island.start(), Scene::Island.start_in(&Land::new(DEFAULT_WORLD_SEED)));
    }

    #[test]
    fn scenes_at_eye_height_start_just_above_their_ground() {
        let land = Land::new(DEFAULT_WORLD_SEED);
        for scene in [Scene::Grass, Scene::Culling] {
            let pose = scene.start();
            let above_m = pose.position_m.y - height_m(&land, pose.position_m) * scene.vertical_scale();
            assert!((1.0..3.0).contains(&above_m), "{scene:?}: {above_m} m above its ground");
        }
    }
}
