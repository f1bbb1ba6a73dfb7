//! Shadows of trees on the GPU against rays through the same trees on the CPU.

use client::features::vegetation::PlantShadows;
use lab::tree_shadow::{PLACES, Wood, turned, wrong};

fn wood(elevation_deg: f32, shadows: PlantShadows) -> Option<Wood> {
    tests::open_gpu_or_skip().map(|gpu| Wood::open(gpu, elevation_deg, shadows))
}

#[test]
fn tree_shadows_agree_with_rays_through_all_trees() {
    for elevation_deg in [12.0, 30.0, 45.0, 70.0] {
        let Some(wood) = wood(elevation_deg, PlantShadows::On) else { return };
        let (found, trees) = (wood.found().expect("the GPU works"), wood.casters().expect("the GPU works"));
        let found: Vec<f32> = found.iter().map(|shade| shade.near).collect();
        let expected = wood.truth(&trees, wood.sun);
        let dark = expected.iter().filter(|sun| **sun < 0.5).count() as f64 / f64::from(PLACES);
        let share = wrong(&found, &expected);
        // Controls: the sun moved by 5 degrees, and no shadows.
        let control = wrong(&found, &wood.truth(&trees, turned(wood.sun)));
        println!(
            "sun {elevation_deg} degrees, {} trees: {:.1} % of {PLACES} places in shadow, {:.2} % wrong; \
             sun moved by 5 degrees {:.1} %",
            trees.len(),
            100.0 * dark,
            100.0 * share,
            100.0 * control
        );
        assert!(dark > 0.05 && trees.len() > 100, "{dark} {}", trees.len());
        assert!(share <= 0.02, "{elevation_deg}: {share}");
        assert!(control > 0.02, "{elevation_deg}: {control}");
    }
}

#[test]
fn far_tree_shadows_agree_with_rays_where_crowns_have_three_pixels() {
    for elevation_deg in [20.0, 45.0] {
        let Some(gpu) = tests::open_gpu_or_skip() else { return };
        let wood = Wood::open_far(gpu, elevation_deg).expect("the GPU works");
        let (found, trees) = (wood.found().expect("the GPU works"), wood.casters().expect("the GPU works"));
        let found: Vec<f32> = found.iter().map(|shade| shade.near).collect();
        let expected = wood.truth(&trees, wood.sun);
        let dark = expected.iter().filter(|sun| **sun < 0.5).count() as f64 / f64::from(PLACES);
        // Controls: the sun moved by 5 degrees, and shadows by the share of no woods.
        let [share, control, none] = [
            wrong(&found, &expected),
            wrong(&found, &wood.truth(&trees, turned(wood.sun))),
            wrong(&vec![1.0; expected.len()], &expected),
        ];
        println!(
            "sun {elevation_deg} degrees, {} trees: {:.1} % of {PLACES} places in shadow, {:.2} % wrong; \
             sun moved by 5 degrees {:.1} %, no shadows {:.1} %",
            trees.len(),
            100.0 * dark,
            100.0 * share,
            100.0 * control,
            100.0 * none
        );
        assert!(dark > 0.05 && trees.len() > 100, "{dark} {}", trees.len());
        assert!(share <= 0.05, "{elevation_deg}: {share}");
        assert!(control > 0.05 && none > 0.05, "{elevation_deg}: {control} {none}");
    }
}

#[test]
fn without_plant_shadows_all_places_have_the_whole_sun() {
    let Some(wood) = wood(30.0, PlantShadows::Off) else { return };
    let found = wood.found().expect("the GPU works");
    assert!(found.iter().all(|shade| shade.near == 1.0 && shade.far == 1.0));
    assert!(!wood.casters().expect("the GPU works").is_empty(), "the trees are placed all the same");
}
