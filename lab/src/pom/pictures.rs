//! Planes as they are drawn: what must be equal, the edges of reliefs, and the lines along which
//! objects meet them.

use crate::pom::renderer::{PomRenderer, around, cut_distance, plane, silhouette_overlap};
use anyhow::{Result, ensure};
use client::features::pom::PomSettings;
use client::features::pom::settings::{PomMethod, Silhouette};
use client::scene::Scene;
use client::scene::objects::Mode;
use client::settings::Show;
use serde::Serialize;

/// Size of the pictures, pixels.
const SIZE: (u32, u32) = (960, 540);

/// Planes against each other and against displaced geometry. Field names are a contract with
/// scripts.
#[derive(Clone, Debug, Serialize)]
pub struct Pictures {
    /// Pixels of planes without amplitude, by every tier.
    pub zero_compared: usize,
    /// How many of them differ from the flat one's.
    pub zero_differing: usize,
    /// The same with amplitude: the control.
    pub raised_differing: usize,
    pub silhouettes: Vec<Silhouettes>,
    pub lines: Vec<Line>,
}

/// Intersection over union with what displaced geometry covers, the worst of three bearings.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Silhouettes {
    /// Camera above the plane, degrees.
    pub elevation_deg: f64,
    pub shell: f64,
    pub rectangle: f64,
    /// Of a plane without a silhouette: the control.
    pub flat: f64,
}

/// The line along which a sunken ball meets a plane: distance to that with displaced geometry,
/// pixels, 99 % below.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Line {
    /// Camera above the plane, degrees.
    pub elevation_deg: f64,
    /// Length of the line, pixels.
    pub pixels: usize,
    /// With the depth of the relief.
    pub with_depth: f64,
    /// With that of the plane: the control.
    pub without_depth: f64,
}

/// Draws and compares.
pub fn measure() -> Result<Pictures> {
    let mut renderer = PomRenderer::open(Scene::Pom, SIZE)?;
    let (zero_compared, zero_differing, raised_differing) = identities(&mut renderer)?;
    let silhouettes = [60.0, 16.0, 5.0].map(|elevation_deg| silhouettes(&mut renderer, elevation_deg));
    let lines = [60.0, 40.0, 16.0, 5.0].map(|elevation_deg| line(&mut renderer, elevation_deg));
    Ok(Pictures {
        zero_compared,
        zero_differing,
        raised_differing,
        silhouettes: silhouettes.into_iter().collect::<Result<_>>()?,
        lines: lines.into_iter().collect::<Result<_>>()?,
    })
}

impl Pictures {
    /// Every control must fail, or what it controls has seen nothing.
    ///
    /// # Errors
    /// One does not.
    pub fn controls(&self) -> Result<()> {
        ensure!(self.raised_differing > 0, "a relief changes nothing in the picture of a plane");
        let flat = self.silhouettes.iter().map(|row| row.flat).fold(1.0, f64::min);
        ensure!(flat < 0.98, "a plane has the silhouette of displaced geometry");
        let shallow = self.lines.iter().map(|row| row.without_depth).fold(0.0, f64::max);
        ensure!(shallow > 1.0, "with the plane's depth objects are cut where geometry cuts them");
        Ok(())
    }
}

fn exact() -> PomSettings {
    PomSettings { method: PomMethod::MaxMip, ..PomSettings::default() }
}

/// Pixels compared, and those that differ from the flat plane's without amplitude and with it.
fn identities(renderer: &mut PomRenderer) -> Result<(usize, usize, usize)> {
    let (mut compared, mut zero, mut raised) = (0, 0, 0);
    for tier in [PomMethod::Offset, PomMethod::Linear, PomMethod::Cones, PomMethod::MaxMip, PomMethod::Auto] {
        let mut differing = |amplitude| -> Result<(usize, usize)> {
            let relief = PomSettings { method: tier, amplitude, ..PomSettings::default() };
            let mut of = |mode| renderer.shown(&[plane(mode)], around(16.0, 20.0, 3.5), relief, Show::Image);
            let (own, flat) = (of(Mode::Settings)?, of(Mode::Flat)?);
            Ok((own.0.len(), own.differing(&flat).count()))
        };
        let (pixels, differs) = differing(0.0)?;
        compared += pixels;
        zero += differs;
        raised += differing(1.0)?.1;
    }
    Ok((compared, zero, raised))
}

/// Edges from an elevation of the camera.
pub fn silhouettes(renderer: &mut PomRenderer, elevation_deg: f64) -> Result<Silhouettes> {
    let mut overlap = |mode, silhouette| {
        silhouette_overlap(renderer, mode, PomSettings { silhouette, ..exact() }, elevation_deg)
    };
    Ok(Silhouettes {
        elevation_deg,
        shell: overlap(Mode::Settings, Silhouette::Shell)?,
        rectangle: overlap(Mode::Settings, Silhouette::Rectangle)?,
        flat: overlap(Mode::Flat, Silhouette::None)?,
    })
}

/// The line of intersection from an elevation of the camera.
pub fn line(renderer: &mut PomRenderer, elevation_deg: f64) -> Result<Line> {
    let deep = PomSettings { depth: true, silhouette: Silhouette::Shell, ..exact() };
    let shallow = PomSettings { depth: false, silhouette: Silhouette::None, ..deep };
    let (with_depth, pixels) = cut_distance(renderer, deep, elevation_deg)?;
    let (without_depth, _) = cut_distance(renderer, shallow, elevation_deg)?;
    Ok(Line { elevation_deg, pixels, with_depth, without_depth })
}
