use super::super::noise::Noise;
use super::*;

const MAP: &str = r#"
name = "mixed"
bounds = [-5.0, -5.0, 5.0, 5.0]
[[box]]
name = "floor"
center = [0.0, 0.0, -0.5]
size = [20.0, 20.0, 1.0]
[[box]]
name = "crate"
center = [2.0, 1.0, 0.4]
size = [0.8, 0.6, 0.8]
rpy_deg = [0.0, 0.0, 30.0]
[[box]]
name = "table"
center = [-2.0, 0.0, 1.0]
size = [1.0, 1.0, 0.1]
[[wedge]]
name = "ramp"
center = [3.0, -2.0, 0.25]
size = [2.0, 1.0, 0.5]
[[cylinder]]
name = "column"
center = [-1.0, 3.0, 1.5]
radius = 0.3
height = 3.0
[[sphere]]
center = [0.0, -3.0, 0.5]
radius = 0.5
[[mesh]]
file = "tent.obj"
position = [-3.0, -3.0, 0.0]
[[victim]]
name = "Anna"
position = [1.0, -3.5, 0.0]
status = "alive"
"#;

const TENT: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1\no tent\n\
                    f 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n";

fn mixed() -> World {
    let meshes = BTreeMap::from([("tent.obj".to_owned(), TENT.as_bytes().to_vec())]);
    World::new(&MapFile::parse(MAP).unwrap(), &meshes).unwrap()
}

#[test]
fn the_tree_finds_what_brute_force_finds() {
    let world = mixed();
    let mut noise = Noise::new(3, 0);
    let mut hits = 0;
    for _ in 0..3000 {
        let origin =
            Point3::new(noise.symmetric(5.0), noise.symmetric(5.0), 1.0 + noise.symmetric(0.9));
        let direction =
            Vector3::new(noise.normal(), noise.normal(), 0.5 * noise.normal()).normalize();
        let brute = (0..world.objects.len())
            .filter_map(|i| Some((world.cast_object(i, &origin, &direction, 8.0)?.0, i)))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let found = world.cast_ray(&origin, &direction, 8.0);
        assert_eq!(found.map(|hit| hit.range_m), brute.map(|(range, _)| range));
        hits += usize::from(found.is_some());
    }
    assert!(hits > 1000);
}

#[test]
fn hits_name_their_objects() {
    let world = mixed();
    let name = |x: f64, y: f64, z: f64, direction: Vector3<f64>| {
        let hit = world.cast_ray(&Point3::new(x, y, z), &direction, 20.0).unwrap();
        world.object(hit.object).name.clone()
    };
    assert_eq!(name(0.0, 0.0, 1.0, -Vector3::z()), "floor");
    assert_eq!(name(-5.0, 3.0, 1.0, Vector3::x()), "column");
    assert_eq!(name(-2.5, -2.5, 3.0, -Vector3::z()), "tent");
    assert_eq!(name(0.0, -3.0, 3.0, -Vector3::z()), "sphere_1");
    assert_eq!(name(1.37, -3.5, 3.0, -Vector3::z()), "Anna/Chest");
}

#[test]
fn spans_unite_what_overlaps_and_keep_the_air_between() {
    let world = mixed();
    let table = world.solid_spans(-2.0, 0.0);
    let ends: Vec<[f64; 2]> = table.iter().map(|s| [s.bottom_m, s.top_m]).collect();
    assert_eq!(ends.len(), 2);
    assert!((ends[0][1]).abs() < 1e-12 && (ends[1][0] - 0.95).abs() < 1e-12);
    // The column stands on the floor: one span.
    let column = world.solid_spans(-1.0, 3.0);
    assert_eq!(column.len(), 1);
    assert!((column[0].top_m - 3.0).abs() < 1e-9);
    // Half way up the ramp, whose slope is 1 in 4.
    let ramp = world.solid_spans(3.0, -2.0);
    assert!((ramp[0].top_m - 0.25).abs() < 1e-9);
    assert!((ramp[0].top_normal.z - 4.0 / 17_f64.sqrt()).abs() < 1e-9);
    // Off the tent's edges, where a closed mesh is crossed twice.
    let tent = world.solid_spans(-2.4, -2.6);
    assert!((tent[0].top_m - 0.8).abs() < 1e-5, "{tent:?}");
}

#[test]
fn a_mesh_that_was_not_handed_over_is_named() {
    let map = MapFile::parse(MAP).unwrap();
    let error = World::new(&map, &BTreeMap::new()).unwrap_err();
    assert_eq!(error, WorldError::MeshMissing("tent.obj".to_owned()));
}

#[test]
fn floor_height_is_that_of_the_surface_below_the_given_height() {
    let world = mixed();
    assert_eq!(world.floor_height_m(-2.0, 0.0, 0.5), Some(0.0));
    let on_table = world.floor_height_m(-2.0, 0.0, 2.0).unwrap();
    assert!((on_table - 1.05).abs() < 1e-12);
    assert_eq!(world.floor_height_m(30.0, 0.0, 2.0), None);
}
