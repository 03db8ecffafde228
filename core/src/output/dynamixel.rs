//! Serial bus servos of Robotis that speak Dynamixel protocol 2.0 and have the X series' control table.
//!
//! In:  a servo command; its calibration counts positions of the servo in place of microseconds.
//! Out: bytes for the half-duplex line. Such packets are not answered, so nothing has to be read.
//!
//! Source: Robotis e-Manual, "DYNAMIXEL Protocol 2.0" (packets, stuffing, CRC-16 with polynomial 0x8005) and the
//! control table of the X series.

use super::packet::{BufferTooSmall, Packet, driven, torques};

const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
const EVERYONE: u8 = 0xFE;
const SYNC_WRITE: u8 = 0x83;
const TORQUE_ENABLE: u16 = 64;
const GOAL_POSITION: u16 = 116;

/// Bytes of header, id and length: where the instruction stands.
const HEAD_BYTES: usize = 7;
const CRC_BYTES: usize = 2;

/// Encoder of packets for the X series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dynamixel;

impl Dynamixel {
    /// A packet that sends servo `ids[i]` to `positions[i]`. A servo of position 0 is left out: it is released, see
    /// [`encode_torque`](Self::encode_torque).
    ///
    /// # Errors
    /// [`BufferTooSmall`]; 7 bytes a servo and 14 are enough, stuffing included.
    pub fn encode_goals<'b>(
        self,
        ids: &[u8],
        positions: &[u16],
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], BufferTooSmall> {
        let goals =
            driven(ids, positions).map(|(id, position)| (id, u32::from(position).to_le_bytes()));
        sync_write(GOAL_POSITION, goals, buffer)
    }

    /// A packet that switches servo `ids[i]` on, or off where `positions[i]` is 0. To be sent when that changes.
    ///
    /// # Errors
    /// [`BufferTooSmall`]; 3 bytes a servo and 14 are enough, stuffing included.
    pub fn encode_torque<'b>(
        self,
        ids: &[u8],
        positions: &[u16],
        buffer: &'b mut [u8],
    ) -> Result<&'b [u8], BufferTooSmall> {
        sync_write(TORQUE_ENABLE, torques(ids, positions), buffer)
    }
}

fn sync_write<const WIDTH: usize>(
    address: u16,
    servos: impl Iterator<Item = (u8, [u8; WIDTH])>,
    buffer: &mut [u8],
) -> Result<&[u8], BufferTooSmall> {
    let mut packet = begin(EVERYONE, buffer);
    let [address_low, address_high] = address.to_le_bytes();
    let head = [SYNC_WRITE, address_low, address_high, WIDTH as u8, 0];
    head.iter().for_each(|&byte| stuff(&mut packet, byte));
    for (id, data) in servos {
        stuff(&mut packet, id);
        data.iter().for_each(|&byte| stuff(&mut packet, byte));
    }
    finish(packet)
}

/// Header, id and room for the length.
fn begin(id: u8, buffer: &mut [u8]) -> Packet<'_> {
    let mut packet = Packet::new(buffer);
    packet.extend(&HEADER);
    packet.extend(&[id, 0, 0]);
    packet
}

/// Adds a byte, and one more where the packet would otherwise contain a header.
fn stuff(packet: &mut Packet<'_>, byte: u8) {
    packet.push(byte);
    let is_header = packet.since(HEAD_BYTES).ends_with(&[0xFF, 0xFF, 0xFD]);
    if is_header {
        packet.push(0xFD);
    }
}

/// Length and CRC.
fn finish(mut packet: Packet<'_>) -> Result<&[u8], BufferTooSmall> {
    let [low, high] = ((packet.len() - HEAD_BYTES + CRC_BYTES) as u16).to_le_bytes();
    packet.set(5, low);
    packet.set(6, high);
    let crc = crc16(packet.since(0));
    packet.extend(&crc.to_le_bytes());
    packet.finish()
}

/// CRC-16 with polynomial 0x8005, from 0, not reflected.
fn crc16(bytes: &[u8]) -> u16 {
    let shift = |crc: u16, _| if crc & 0x8000 != 0 { crc << 1 ^ 0x8005 } else { crc << 1 };
    bytes.iter().fold(0, |crc, &byte| (0..8).fold(crc ^ u16::from(byte) << 8, shift))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use std::vec::Vec;

    use super::*;

    #[test]
    fn buffer_that_is_too_small_is_refused_with_what_is_needed() {
        let refused = Dynamixel.encode_goals(&[1, 2], &[150, 170], &mut [0; 23]).err();
        assert_eq!(refused, Some(BufferTooSmall { bytes: 23, needed: 24 }));
    }

    #[test]
    fn ping_is_that_of_the_manual() {
        let mut buffer = [0; 16];
        let mut packet = begin(1, &mut buffer);
        stuff(&mut packet, 0x01);
        let ping = [0xFF, 0xFF, 0xFD, 0, 1, 3, 0, 1, 0x19, 0x4E];
        assert_eq!(finish(packet).unwrap(), ping);
    }

    #[test]
    fn goals_of_two_servos_are_those_of_the_manual() {
        let mut buffer = [0; 32];
        let manual = [
            0xFF, 0xFF, 0xFD, 0, 0xFE, 0x11, 0, 0x83, 0x74, 0, 4, 0, 1, 0x96, 0, 0, 0, 2, 0xAA, 0,
            0, 0, 0x82, 0x87,
        ];
        assert_eq!(Dynamixel.encode_goals(&[1, 2], &[150, 170], &mut buffer).unwrap(), manual);
    }

    #[test]
    fn released_servo_gets_no_goal_and_no_torque() {
        let mut buffer = [0; 32];
        let goals = Dynamixel.encode_goals(&[9, 8], &[0, 5], &mut buffer).unwrap();
        assert_eq!((goals.len(), goals[12]), (19, 8));
        let torque = Dynamixel.encode_torque(&[9, 8], &[0, 5], &mut buffer).unwrap();
        assert_eq!(torque[7..16], [0x83, 64, 0, 1, 0, 9, 0, 8, 1]);
    }

    proptest! {
        #[test]
        fn header_stands_at_the_start_alone(
            servos in prop::collection::vec((any::<u8>(), prop_oneof![Just(0xFFFF), Just(0xFDFF), any::<u16>()]), 0..32)
        ) {
            let (ids, positions): (Vec<u8>, Vec<u16>) = servos.into_iter().unzip();
            let mut buffer = [0; 7 * 32 + 14];
            let packet = Dynamixel.encode_goals(&ids, &positions, &mut buffer).unwrap();
            let headers = packet[..packet.len() - 2].windows(4).filter(|window| *window == HEADER);
            prop_assert_eq!(headers.count(), 1);
            let length = usize::from(u16::from_le_bytes([packet[5], packet[6]]));
            let (checked, crc) = packet.split_at(packet.len() - CRC_BYTES);
            prop_assert_eq!((length, crc), (packet.len() - HEAD_BYTES, &crc16(checked).to_le_bytes()[..]));
        }
    }
}
