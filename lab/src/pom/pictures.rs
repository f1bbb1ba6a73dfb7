//! Planes as they are drawn: what must be equal, the edges of reliefs, and the lines along which
//! objects meet them.

use crate::relief::pictures::{ReliefStudio, around, cut_distance, plane, silhouette_overlap};
use anyhow::{Result, ensure};
use client::looks::Show;
use client::relief::ReliefKnobs;
use client::relief::knobs::{ReliefTier, Silhouette};
use client::render::scenes::relief::objects::Mode;
use client::scene::Scene;
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
    /// Edges.
    pub silhouettes: Vec<Silhouettes>,
    /// Lines of intersection.
    pub lines: Vec<Line>,
}

/// Intersection over union with what displaced geometry covers, the worst of three bearings.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Silhouettes {
    /// Camera above the plane, degrees.
    pub elevation_deg: f64,
    /// Of the shell.
    pub shell: f64,
    /// Of the rectangle.
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

/// Draws and compares, and prints it.
///
/// # Errors
/// There is no GPU, or it failed.
pub fn measure() -> Result<Pictures> {
    let mut studio = ReliefStudio::open(Scene::Pom, SIZE)?;
    let (zero_compared, zero_differing, raised_differing) = identities(&mut studio)?;
    let silhouettes = [60.0, 16.0, 5.0].map(|elevation_deg| silhouettes(&mut studio, elevation_deg));
    let lines = [60.0, 40.0, 16.0, 5.0].map(|elevation_deg| line(&mut studio, elevation_deg));
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

fn exact() -> ReliefKnobs {
    ReliefKnobs { tier: ReliefTier::Pyramid, ..ReliefKnobs::default() }
}

/// Pixels compared, and those that differ from the flat plane's without amplitude and with it.
fn identities(studio: &mut ReliefStudio) -> Result<(usize, usize, usize)> {
    let (mut compared, mut zero, mut raised) = (0, 0, 0);
    for tier in
        [ReliefTier::Offset, ReliefTier::Linear, ReliefTier::Cones, ReliefTier::Pyramid, ReliefTier::Auto]
    {
        let mut differing = |amplitude| -> Result<(usize, usize)> {
            let relief = ReliefKnobs { tier, amplitude, ..ReliefKnobs::default() };
            let mut of = |mode| studio.shown(&[plane(mode)], around(16.0, 20.0, 3.5), relief, Show::Picture);
            let (own, flat) = (of(Mode::Knobs)?, of(Mode::Flat)?);
            Ok((own.0.len(), own.differing(&flat).count()))
        };
        let (pixels, differs) = differing(0.0)?;
        compared += pixels;
        zero += differs;
        raised += differing(1.0)?.1;
    }
    println!("without amplitude {zero} of {compared} pixels differ from the flat plane's, with it {raised}");
    Ok((compared, zero, raised))
}

fn silhouettes(studio: &mut ReliefStudio, elevation_deg: f64) -> Result<Silhouettes> {
    let mut overlap = |mode, silhouette| {
        silhouette_overlap(studio, mode, ReliefKnobs { silhouette, ..exact() }, elevation_deg)
    };
    let row = Silhouettes {
        elevation_deg,
        shell: overlap(Mode::Knobs, Silhouette::Shell)?,
        rectangle: overlap(Mode::Knobs, Silhouette::Rectangle)?,
        flat: overlap(Mode::Flat, Silhouette::None)?,
    };
    println!(
        "silhouette at {elevation_deg} degrees: shell {:.4}, rectangle {:.4}, none {:.4}",
        row.shell, row.rectangle, row.flat
    );
    Ok(row)
}

fn line(studio: &mut ReliefStudio, elevation_deg: f64) -> Result<Line> {
    let deep = ReliefKnobs { depth: true, silhouette: Silhouette::Shell, ..exact() };
    let shallow = ReliefKnobs { depth: false, silhouette: Silhouette::None, ..deep };
    let (with_depth, pixels) = cut_distance(studio, deep, elevation_deg)?;
    let (without_depth, _) = cut_distance(studio, shallow, elevation_deg)?;
    println!(
        "line of intersection at {elevation_deg} degrees, {pixels} pixels: {with_depth:.2} px off, with the plane's depth {without_depth:.2} px"
    );
    Ok(Line { elevation_deg, pixels, with_depth, without_depth })
}
