//! The scenes, with their light and start camera.

pub mod objects;

use crate::camera::Pose;
use crate::features::vegetation::VegetationSettings;
use crate::lighting::SunLight;
use glam::{DVec3, Vec3};

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
    /// A bay in three panels: parallax mapping, the selected --water tier, the ray-marched
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

    /// Start camera.
    #[must_use]
    pub fn start(self) -> Pose {
        match self {
            Self::Island => {
                Pose { position_m: DVec3::new(-5200.0, 160.0, 1500.0), yaw_deg: 70.0, pitch_deg: -8.0 }
            }
            Self::Grass => {
                Pose { position_m: DVec3::new(-1460.0, 193.4, 1240.0), yaw_deg: 35.0, pitch_deg: -4.0 }
            }
            // Floor of a narrow valley: its sides occlude almost all vegetation in view.
            Self::Culling => {
                Pose { position_m: DVec3::new(1003.6, 50.0, 3614.4), yaw_deg: 249.7, pitch_deg: -2.0 }
            }
            Self::Water => Pose { position_m: DVec3::new(0.0, 7.5, 7.0), yaw_deg: 0.0, pitch_deg: -29.0 },
            // 16 degrees above the planes, looking at their middle.
            Self::Pom => Pose { position_m: DVec3::new(0.0, 3.64, 12.70), yaw_deg: 0.0, pitch_deg: -16.0 },
            Self::Brick => Pose { position_m: DVec3::new(-2.6, 1.7, 3.3), yaw_deg: 30.0, pitch_deg: -6.0 },
            Self::Spom => Pose { position_m: DVec3::new(-0.1, 2.55, 6.5), yaw_deg: 0.0, pitch_deg: -16.0 },
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
            Self::Island => 4600.0,
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
