//! View parameters: everything that a frame depends on apart from the chunks.

use crate::camera::{Pose, Projection};
use crate::settings::RenderSettings;
use glam::DVec3;
use protocol::limits::MAX_VIEWPORT;
use protocol::view::View;
use terrain::lod::{MAX_VIEW_DISTANCE_M, Viewer};

/// Share of the tolerance that chunks are selected by, on the server and here. The rest covers the
/// row of cells beside a coarser chunk, where a part of its error adds to the chunk's own: at most
/// 0.051 tolerances in all measured views (measured, not proved).
const SELECTION_SHARE: f64 = 15.0 / 16.0;

/// Camera and settings of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewParams {
    /// Position and direction of the camera.
    pub pose: Pose,
    /// Field of view and image size.
    pub projection: Projection,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// Time of the animated parts (waves, clouds), seconds.
    pub time_s: f32,
    /// Render settings.
    pub settings: RenderSettings,
}

impl ViewParams {
    /// The projection of the rendered picture; the image's is `self.projection`. Everything that
    /// counts pixels on screen uses it.
    #[must_use]
    pub fn rendered(&self) -> Projection {
        let (width, height) =
            self.settings.post.rendered_size((self.projection.width, self.projection.height));
        Projection { width, height, ..self.projection }
    }

    /// The parameters with every number finite and in its range; valid ones are unchanged. The
    /// settings have their own ([`RenderSettings`]'s parts clamp themselves).
    #[must_use]
    pub fn sanitized(&self) -> Self {
        let finite = |number: f64, otherwise: f64| if number.is_finite() { number } else { otherwise };
        let p = self.pose.position_m;
        let position_m = DVec3::new(finite(p.x, 0.0), finite(p.y, 0.0), finite(p.z, 0.0));
        let yaw_deg = finite(self.pose.yaw_deg, 0.0);
        let pitch_deg = finite(self.pose.pitch_deg, 0.0);
        // The heading stays as it was given: its remainder is rounded.
        let pose = Pose { yaw_deg, ..Pose { position_m, yaw_deg, pitch_deg }.clamped() };
        let side = |side: u32| side.clamp(1, MAX_VIEWPORT.into());
        Self {
            pose,
            projection: Projection {
                fov_deg: finite(self.projection.fov_deg, 60.0).clamp(1.0, 170.0),
                width: side(self.projection.width),
                height: side(self.projection.height),
            },
            view_distance_m: self.view_distance_m.min(MAX_VIEW_DISTANCE_M),
            tolerance_px: finite(self.tolerance_px, 1.0).clamp(0.0, f64::from(u16::MAX)),
            time_s: if self.time_s.is_finite() { self.time_s } else { 0.0 },
            settings: self.settings,
        }
    }

    /// The view as sent to the server, rounded to the protocol's integers.
    #[must_use]
    pub fn protocol_view(&self, id: u32) -> View {
        let mdeg = |degrees: f64| (degrees * 1000.0).round() as i32;
        let (pose, rendered) = (self.pose.clamped(), self.rendered());
        View {
            id,
            eye: pose.eye().units,
            velocity: [0; 3],
            yaw_mdeg: mdeg(pose.yaw_deg),
            pitch_mdeg: mdeg(pose.pitch_deg),
            fov_mdeg: mdeg(self.projection.fov_deg).clamp(1_000, 170_000) as u32,
            viewport: [rendered.width, rendered.height].map(|side| side.clamp(1, MAX_VIEWPORT.into()) as u16),
            tolerance_q4: (self.tolerance_px * 16.0 * SELECTION_SHARE).floor().clamp(1.0, 65_535.0) as u16,
            distance_m: self.view_distance_m.min(MAX_VIEW_DISTANCE_M),
        }
    }

    /// The part of the view that selects chunks, with the same integers as on the server.
    #[must_use]
    pub fn viewer(&self) -> Viewer {
        self.protocol_view(0).viewer()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tolerance_is_sixteenths_of_a_pixel_and_never_zero() {
        let tolerance = |tolerance_px| ViewParams { tolerance_px, ..view("0,0,0,0,0") }.viewer().tolerance_q4;
        assert_eq!((tolerance(2.0), tolerance(1.0), tolerance(0.0), tolerance(0.06)), (30, 15, 1, 1));
        assert_eq!(view("0,0,0,0,0").viewer().pixels_per_radian, 312);
    }

    #[test]
    fn invalid_numbers_become_valid_and_valid_ones_stay() {
        for camera in ["0,0,0,0,0", "-3000.5,120.25,77,-359.9,-90", "1,20000,2,360,90"] {
            assert_eq!(view(camera).sanitized(), view(camera));
        }
        for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX] {
            let view = ViewParams {
                pose: Pose { position_m: DVec3::splat(odd), yaw_deg: odd, pitch_deg: odd },
                projection: Projection { fov_deg: odd, width: 0, height: u32::MAX },
                tolerance_px: odd,
                time_s: odd as f32,
                ..view("0,0,0,0,0")
            };
            let sane = view.sanitized();
            assert_eq!(sane.sanitized(), sane);
            assert!(sane.pose.forward().is_finite() && sane.projection.near_m() > 0.0, "{sane:?}");
            assert_eq!(sane.projection.width, 1);
        }
    }

    fn view(camera: &str) -> ViewParams {
        ViewParams {
            pose: camera.parse().unwrap(),
            projection: Projection { fov_deg: 60.0, width: 640, height: 360 },
            view_distance_m: 2000,
            tolerance_px: 4.0,
            time_s: 0.0,
            settings: RenderSettings::default(),
        }
    }
}
