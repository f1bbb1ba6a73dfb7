//! The scenes that exist. Each one names its light and where its camera starts.

use crate::camera::Pose;
use crate::frame::Light;
use crate::plants::PlantKnobs;
use glam::{DVec3, Vec3};

/// A scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Scene {
    /// The streamed archipelago, seen over the home island.
    #[default]
    Island,
    /// The island at eye height in a meadow, with grass and trees. Makes its land itself unless
    /// --connect is given
    Grass,
    /// The island 1.8 times as high, so that hills hide what grows behind them. Makes its land
    /// itself unless --connect is given
    Culling,
    /// A bay, three times side by side: plain parallax, the chosen tier of --water, the marched
    /// truth. Needs no server
    Water,
    /// Cobbles on four planes: flat, by a single offset, as the knobs say, and as displaced
    /// geometry. Needs no server
    Pom,
    /// A wall of bricks whose depth is all parallax. Needs no server
    Brick,
    /// A plane, a sphere, a capsule and a cube whose edges follow their relief. Needs no server
    Spom,
}

impl Scene {
    /// Whether the scene is complete in itself: no server is asked, no chunk is drawn.
    #[must_use]
    pub fn is_local(self) -> bool {
        match self {
            Self::Island | Self::Grass | Self::Culling => false,
            Self::Water | Self::Pom | Self::Brick | Self::Spom => true,
        }
    }

    /// Whether all of the scene fits into a room, so that a camera over land would be too fast and
    /// too far for it.
    #[must_use]
    pub fn is_room(self) -> bool {
        match self {
            Self::Island | Self::Grass | Self::Culling | Self::Water => false,
            Self::Pom | Self::Brick | Self::Spom => true,
        }
    }

    /// What its parts are, for the panel, if it is a local scene.
    #[must_use]
    pub fn panels(self) -> Option<&'static str> {
        match self {
            Self::Island | Self::Grass | Self::Culling => None,
            Self::Water => Some("left: plain parallax, middle: --water, right: truth"),
            Self::Pom => Some("from left: flat, one offset, --relief, displaced geometry"),
            Self::Brick => Some("a flat wall: look along it to see where parallax ends"),
            Self::Spom => Some("from left: plane, sphere, capsule, cube; cut by --silhouette"),
        }
    }

    /// A camera worth starting with.
    #[must_use]
    pub fn start(self) -> Pose {
        match self {
            Self::Island => {
                Pose { position_m: DVec3::new(-5200.0, 160.0, 1500.0), yaw_deg: 70.0, pitch_deg: -8.0 }
            }
            Self::Grass => {
                Pose { position_m: DVec3::new(-1460.0, 193.4, 1240.0), yaw_deg: 35.0, pitch_deg: -4.0 }
            }
            // The floor of a narrow valley: its sides hide nearly all that grows within the view.
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

    /// Whether the scene makes its land itself where no server is named.
    #[must_use]
    pub fn has_own_land(self) -> bool {
        matches!(self, Self::Grass | Self::Culling)
    }

    /// What grows in it.
    #[must_use]
    pub fn plants(self) -> PlantKnobs {
        match self {
            Self::Grass => PlantKnobs::STANDARD,
            Self::Culling => PlantKnobs::SPARSE,
            _ => PlantKnobs::NONE,
        }
    }

    /// How much higher its land is than the true one.
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

    /// The light of the scene: a late morning sun in the south-east; over the bay one that stands
    /// beyond it, so that the waves glitter.
    #[must_use]
    pub fn light(self) -> Light {
        match self {
            Self::Island | Self::Grass | Self::Culling => {
                Light { sun: Vec3::new(0.66, 0.43, 0.50).normalize(), exposure: 1.0 }
            }
            Self::Water => Light { sun: Vec3::new(0.62, 0.58, -0.50).normalize(), exposure: 1.0 },
            // From beyond, and hardly from the side: all four planes are lit alike, however far
            // left or right they are.
            Self::Pom => Light { sun: Vec3::new(-0.20, 0.50, -0.55).normalize(), exposure: 1.0 },
            // Low and from the side, so that stones throw shadows.
            Self::Spom => Light { sun: Vec3::new(-0.62, 0.50, 0.30).normalize(), exposure: 0.85 },
            Self::Brick => Light { sun: Vec3::new(-0.62, 0.55, 0.55).normalize(), exposure: 1.0 },
        }
    }
}
