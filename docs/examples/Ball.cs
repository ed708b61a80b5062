// Unity with the package OscJack: turns an object as the ball turns.
// Start `spheremouse run ... --output osc:127.0.0.1:9000` first.
using OscJack;
using UnityEngine;

public class Ball : MonoBehaviour
{
    OscServer server;
    Quaternion latest = Quaternion.identity;

    void OnEnable()
    {
        server = new OscServer(9000);
        // w, x, y, z; Unity's Z points away from the camera, so rotations about X and Y change their sign.
        server.MessageDispatcher.AddCallback("/spheremouse/1/quaternion", (address, q) =>
            latest = new Quaternion(-q.GetElementAsFloat(1), -q.GetElementAsFloat(2),
                q.GetElementAsFloat(3), q.GetElementAsFloat(0)));
    }

    void Update() => transform.rotation = latest;

    void OnDisable() => server.Dispose();
}
