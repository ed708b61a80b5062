# Godot 4: turns a Node3D as the ball turns. Start `spheremouse run ... --output osc:127.0.0.1:9000` first.
extends Node3D

var receiver := PacketPeerUDP.new()

func _ready() -> void:
	receiver.bind(9000, "127.0.0.1")

func _process(_delta: float) -> void:
	while receiver.get_available_packet_count() > 0:
		var bundle := StreamPeerBuffer.new()
		bundle.big_endian = true
		bundle.data_array = receiver.get_packet()
		bundle.seek(16)  # after the word #bundle and the time tag
		while bundle.get_available_bytes() > 0:
			var size := bundle.get_32()
			var next := bundle.get_position() + size
			var address := padded_string(bundle)
			padded_string(bundle)  # the types
			if address == "/spheremouse/1/quaternion":
				var w := bundle.get_float()
				quaternion = Quaternion(bundle.get_float(), bundle.get_float(), bundle.get_float(), w)
			bundle.seek(next)

func padded_string(bundle: StreamPeerBuffer) -> String:
	var text := ""
	while true:
		var four := bundle.get_string(4)  # a string ends with one to four zeros
		text += four
		if four.length() < 4:
			return text
	return text
