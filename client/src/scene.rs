//! The scenes that exist. Each one names its light and where its camera starts.

use crate::camera::Pose;
use crate::frame::Light;
use glam::{DVec3, Vec3};

/// A scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Scene {
    /// The streamed archipelago, seen over the home island.
    #[default]
    Island,
}

impl Scene {
    /// A camera worth starting with.
    #[must_use]
    pub fn start(self) -> Pose {
        match self {
            Self::Island => {
                Pose { position_m: DVec3::new(-5200.0, 160.0, 1500.0), yaw_deg: 70.0, pitch_deg: -8.0 }
            }
        }
    }

    /// Distance to the point that the start camera circles in orbit mode, metres.
    #[must_use]
    pub fn orbit_radius_m(self) -> f64 {
        match self {
            Self::Island => 4600.0,
        }
    }

    /// The light of the scene: a late morning sun in the south-east.
    #[must_use]
    pub fn light(self) -> Light {
        match self {
            Self::Island => Light { sun: Vec3::new(0.66, 0.43, 0.50).normalize(), exposure: 1.0 },
        }
    }
}
