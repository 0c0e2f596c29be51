use super::*;

const STATION: &str = include_str!("../../../../maps/station.toml");

fn at(pose: &str) -> Client {
    let mut client = Client::new(STATION, &scenario("[noise]\n"));
    client.send(&format!("INIT {{ClassName USARBot.P3AT}} {{Name R1}} {pose}"));
    client.run(1.0);
    client
}

#[test]
fn the_seam_between_two_slabs_is_not_felt() {
    let mut client = at("{Location 1.0,2.0,-0.2} {Rotation 0,0,3.14159}");
    client.send("DRIVE {Left 5} {Right 5}");
    let mut heights = Vec::new();
    for _ in 0..130 {
        client.run(0.2);
        heights.push(client.truth().world_from_robot.translation.z);
        let truth = client.truth();
        if truth.world_from_robot.translation.x < -10.0 {
            break;
        }
    }
    let truth = client.truth();
    assert!(truth.world_from_robot.translation.x < -10.0, "{truth:?}");
    let spread = heights.iter().fold(0.0_f64, |most, z| most.max((z - heights[0]).abs()));
    assert!(spread < 0.002, "{spread}");
    assert_eq!((truth.collisions, truth.falls), (0, 0));
    assert_eq!(truth.portals, ["to_platform_2"]);
}

#[test]
fn the_service_ramp_leads_down_and_back_up() {
    let mut client = at("{Location -9.0,9.85,-0.2} {Rotation 0,0,0}");
    client.send("DRIVE {Left 4} {Right 4}");
    client.run(18.0);
    let below = client.truth();
    assert!(below.world_from_robot.translation.z < -0.8, "{below:?}");
    client.send("DRIVE {Left -4} {Right -4}");
    client.run(18.0);
    let above = client.truth();
    assert!(above.world_from_robot.translation.z > 0.1, "{above:?}");
    assert_eq!((above.falls, above.collisions), (0, 0));
}

#[test]
fn the_platform_s_edge_is_a_fall() {
    let mut client = at("{Location -6.0,-3.4,-0.2} {Rotation 0,0,1.5708}");
    client.send("DRIVE {Left 3} {Right 3}");
    client.run(8.0);
    let truth = client.truth();
    assert_eq!(truth.falls, 1);
    assert!(truth.world_from_robot.translation.z < -0.5);
}
