//! Layouts of what every picture needs against reflection: frame uniforms, post passes.

use super::{assert_same_layout, passes, reflected};
use crate::SHADERS;
use crate::layout::{Atmosphere, Exposure, Frame, METER_GROUPS, Post};
use std::mem::offset_of;

#[test]
fn frame_uniforms_have_the_layout_of_the_shaders() {
    let expected = [
        ("clip_from_camera", offset_of!(Frame, clip_from_camera)),
        ("ray_right", offset_of!(Frame, ray_right)),
        ("time_s", offset_of!(Frame, time_s)),
        ("ray_up", offset_of!(Frame, ray_up)),
        ("eye_height_m", offset_of!(Frame, eye_height_m)),
        ("ray_forward", offset_of!(Frame, ray_forward)),
        ("view_distance_m", offset_of!(Frame, view_distance_m)),
        ("sun", offset_of!(Frame, sun)),
        ("exposure", offset_of!(Frame, exposure)),
        ("eye_fraction_m", offset_of!(Frame, eye_fraction_m)),
        ("pixel", offset_of!(Frame, pixel)),
        ("pattern_eye_m", offset_of!(Frame, pattern_eye_m)),
        ("viewport", offset_of!(Frame, viewport)),
        ("diffuse", offset_of!(Frame, diffuse)),
        ("visibility", offset_of!(Frame, visibility)),
        ("tiling", offset_of!(Frame, tiling)),
        ("water_tier", offset_of!(Frame, water_tier)),
        ("shadows", offset_of!(Frame, shadows)),
        ("show", offset_of!(Frame, show)),
        ("pixels_per_radian", offset_of!(Frame, pixels_per_radian)),
        ("tolerance_px", offset_of!(Frame, tolerance_px)),
        ("parallax_factor", offset_of!(Frame, parallax_factor)),
        ("parallax_bias_m", offset_of!(Frame, parallax_bias_m)),
        ("wave_steepness", offset_of!(Frame, wave_steepness)),
        ("grass", offset_of!(Frame, grass)),
        ("pom", offset_of!(Frame, pom)),
        ("atmosphere", offset_of!(Frame, atmosphere)),
    ];
    let expected: Vec<_> = expected.into_iter().map(|(name, offset)| (name.to_owned(), offset)).collect();
    let atmosphere = [
        ("sun", offset_of!(Atmosphere, sun)),
        ("sun_aloft", offset_of!(Atmosphere, sun_aloft)),
        ("toward", offset_of!(Atmosphere, toward)),
        ("away", offset_of!(Atmosphere, away)),
        ("upward", offset_of!(Atmosphere, upward)),
        ("multiple_scattering", offset_of!(Atmosphere, multiple_scattering)),
        ("sky_mean", offset_of!(Atmosphere, sky_mean)),
        ("sky_east", offset_of!(Atmosphere, sky_east)),
        ("sky_up", offset_of!(Atmosphere, sky_up)),
        ("sky_south", offset_of!(Atmosphere, sky_south)),
    ];
    let atmosphere: Vec<_> = atmosphere.into_iter().map(|(name, offset)| (name.to_owned(), offset)).collect();
    // Filters of finished colours know no frame.
    let filters = ["antialias", "filter_bloom", "resample"];
    let drawing = passes(false).filter(|shader| !filters.contains(&shader.name));
    let computing = [
        &SHADERS.integrate_sky,
        &SHADERS.light_trees,
        &SHADERS.meter_exposure,
        &SHADERS.place_trees,
        &SHADERS.prepare_grass,
        &SHADERS.prepare_trees,
        &SHADERS.probe_atmosphere,
        &SHADERS.probe_tree_shade,
        &SHADERS.probe_waves,
    ];
    for shader in drawing.chain(computing) {
        assert_eq!(reflected(shader, "Frame"), (expected.clone(), size_of::<Frame>()), "{}", shader.name);
        assert_eq!(
            reflected(shader, "Atmosphere"),
            (atmosphere.clone(), size_of::<Atmosphere>()),
            "{}",
            shader.name
        );
    }
}

#[test]
fn post_data_has_the_layout_of_the_shaders() {
    for shader in [SHADERS.tonemap, SHADERS.meter_exposure, SHADERS.resample] {
        #[rustfmt::skip]
        assert_same_layout!(
            shader, Post, tone, auto_exposure, bloom, sharpen, meter, adaptation, scale,
        );
    }
    for shader in [SHADERS.tonemap, SHADERS.meter_exposure] {
        assert_same_layout!(shader, Exposure, ev, factor, is_set, reserved);
    }
    let groups = format!("GROUPS: u32 = {METER_GROUPS}u;");
    assert!(SHADERS.meter_exposure.wgsl.contains(&groups), "{groups}");
}
